"""Link URLs and what people are told about wrong ones."""

import pytest

from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.address import NetworkAddress, SerialAddress, check_url, parse_url


@pytest.mark.parametrize(
    ("url", "address"),
    [
        ("udpin:127.0.0.1:14540", NetworkAddress("udpin", "127.0.0.1", 14540)),
        ("udpout:drone.local:14580", NetworkAddress("udpout", "drone.local", 14580)),
        ("tcp:127.0.0.1:5760", NetworkAddress("tcp", "127.0.0.1", 5760)),
        ("tcpin:[::1]:5760", NetworkAddress("tcpin", "::1", 5760)),
        ("udpin:127.0.0.1:0", NetworkAddress("udpin", "127.0.0.1", 0)),
        ("serial:/dev/ttyACM0:921600", SerialAddress("/dev/ttyACM0", 921600)),
        ("serial:/dev/serial/by-path/pci-0:1:57600", SerialAddress("/dev/serial/by-path/pci-0:1", 57600)),
    ],
)
def test_good_urls_are_read_and_written_alike(url, address):
    assert parse_url(url) == address
    assert address.url == url


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("", "unknown kind ''"),
        ("127.0.0.1:14540", "unknown kind '127.0.0.1'; write udpin:HOST:PORT"),
        ("udp:127.0.0.1:14540", "unknown kind 'udp'"),
        ("udpin:14540", "write udpin:HOST:PORT"),
        ("udpin://127.0.0.1:14540", "write udpin:HOST:PORT"),
        ("udpin:127.0.0.1:mavlink", "port 'mavlink' is not a number from 0 to 65535"),
        ("udpin:127.0.0.1:65536", "port '65536'"),
        ("udpin:127.0.0.1:-1", "port '-1'"),
        ("udpin:127.0.0.1:²", "port '²'"),
        ("udpout:127.0.0.1:0", "port '0' is not a number from 1 to 65535"),
        ("serial:/dev/ttyACM0", "write udpin:HOST:PORT"),
        ("serial:/dev/ttyACM0:fast", "baud rate 'fast'"),
        ("serial:/dev/ttyACM0:0", "baud rate '0'"),
    ],
)
def test_a_bad_url_is_explained_in_one_line(url, said):
    with pytest.raises(UserError) as info:
        parse_url(url)
    assert said in str(info.value)
    assert "\n" not in str(info.value)
    assert repr(url) in str(info.value)


@pytest.mark.parametrize("kind", ["udpin", "tcpin"])
@pytest.mark.parametrize("host", ["0.0.0.0", "192.0.2.1", "[::]"])
def test_listening_for_other_machines_needs_permission(kind, host):
    with pytest.raises(UserError, match=r"listen on 127\.0\.0\.1, or set link\.allow_remote = true"):
        check_url(f"{kind}:{host}:14540", allow_remote=False)
    assert check_url(f"{kind}:{host}:14540", allow_remote=True)


@pytest.mark.parametrize(
    "url", ["udpin:127.0.0.1:1", "udpin:127.9.9.9:1", "tcpin:[::1]:1", "udpin:localhost:1"]
)
def test_listening_on_loopback_needs_none(url):
    assert check_url(url, allow_remote=False)


@pytest.mark.parametrize("url", ["udpout:192.0.2.1:14580", "tcp:192.0.2.1:5760", "serial:/dev/x:57600"])
def test_calling_out_needs_none(url):
    assert check_url(url, allow_remote=False)


def test_an_unknown_host_is_named():
    # A name with an empty label is refused before anybody is asked.
    with pytest.raises(UserError, match=r"unknown host 'no\.\.such\.host'; check the name"):
        check_url("udpout:no..such.host:14580", allow_remote=False)
