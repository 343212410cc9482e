"""Key files: what may be in them, who may read them, and that nobody sees the key."""

import base64
import copy
import hashlib
import os
import pickle
import traceback

import pytest
from typer.testing import CliRunner

from kffa_offboard.cli import app
from kffa_offboard.config import bundled
from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.signing_key import SigningKey, key_of_passphrase, read_key, write_new_key

SECRET = bytes(range(201, 233))


@pytest.fixture
def key_file(tmp_path):
    def write(content, mode=0o600):
        path = tmp_path / "vehicle.key"
        path.write_bytes(content)
        path.chmod(mode)
        return path

    return write


@pytest.mark.parametrize(
    "content",
    [
        SECRET,
        SECRET.hex().encode(),
        SECRET.hex().upper().encode() + b"\n",
        base64.b64encode(SECRET) + b"\r\n",
    ],
    ids=["raw", "hex", "hex with line end", "base64"],
)
def test_a_key_is_read_in_each_form(key_file, content):
    assert read_key(key_file(content)).reveal() == SECRET


def test_a_passphrase_gives_the_key_that_ground_stations_make_of_it(key_file):
    expected = hashlib.sha256("blå himmel 7".encode()).digest()
    assert read_key(key_file("passphrase: blå himmel 7\n".encode())).reveal() == expected
    assert key_of_passphrase("blå himmel 7").reveal() == expected


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\n",
        b"secret words that are no key",
        SECRET[:31],
        SECRET + b"\n",
        SECRET.hex()[:62].encode(),
        SECRET.hex()[:32].encode(),  # 32 characters, but not 32 random bytes
        base64.b64encode(SECRET[:24]),
        bytes(32),
        b"00" * 32,
        b"passphrase:",
        b"passphrase:   \n",
        b"passphrase: \xff\xfe",
        b"x" * 100_000,
    ],
)
def test_what_is_no_key_is_refused_without_a_word_of_it(key_file, content):
    path = key_file(content)
    with pytest.raises(UserError) as refused:
        read_key(path)
    said = str(refused.value)
    assert "is no key" in said and "64 hexadecimal digits" in said
    assert "\n" not in said
    text = content.decode(errors="replace").strip("\n\x00 ")
    assert not text or text.startswith("passphrase:") or text not in said


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o660, 0o644, 0o666, 0o601])
def test_a_key_that_others_can_use_is_refused_with_the_remedy(key_file, mode):
    path = key_file(SECRET, mode)
    with pytest.raises(UserError, match=f"others can use it .mode {mode:04o}.; chmod 600 {path}"):
        read_key(path)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_a_key_that_belongs_to_another_user_is_refused(key_file, monkeypatch):
    path = key_file(SECRET)
    os.chown(path, 12345, -1)
    with pytest.raises(UserError, match="belongs to another user"):
        read_key(path)


def test_a_missing_key_a_directory_and_a_pipe_are_refused(tmp_path):
    with pytest.raises(UserError, match="no such file; make one with: kffa-offboard key"):
        read_key(tmp_path / "none.key")
    with pytest.raises(UserError, match="cannot be read"):
        read_key(tmp_path)
    with pytest.raises(UserError, match="not a regular file"):
        read_key(type(tmp_path)("/dev/zero"))


def test_a_key_does_not_show_itself():
    key = SigningKey(SECRET)
    shown = [repr(key), str(key), f"{key}", repr([key]), repr(copy.copy)]
    try:
        raise ValueError(key)
    except ValueError:
        shown.append(traceback.format_exc())
    assert not any(hint in text for text in shown for hint in (SECRET.hex(), repr(SECRET), str(SECRET)[2:12]))
    for copying in (pickle.dumps, copy.copy, copy.deepcopy):
        with pytest.raises(TypeError, match="not written anywhere"):
            copying(key)


def test_the_command_makes_a_key_for_its_owner_alone_and_does_not_show_it(tmp_path):
    path, mask = tmp_path / "new.key", os.umask(0)
    try:
        result = CliRunner().invoke(app, ["key", str(path)])
    finally:
        os.umask(mask)
    assert result.exit_code == 0
    assert path.stat().st_mode & 0o777 == 0o600
    secret = read_key(path).reveal()
    assert len(secret) == 32
    assert secret.hex() not in result.output
    again = CliRunner().invoke(app, ["key", str(path)])
    assert again.exit_code != 0
    assert read_key(path).reveal() == secret


def test_the_command_makes_the_key_of_a_passphrase(tmp_path):
    path = tmp_path / "words.key"
    result = CliRunner().invoke(app, ["key", str(path), "--passphrase"], input="mavlink\nmavlink\n")
    assert result.exit_code == 0
    assert "mavlink" not in result.output.replace(str(path), "").lower()
    assert read_key(path).reveal() == hashlib.sha256(b"mavlink").digest()


def test_a_passphrase_that_nobody_types_makes_no_key(tmp_path, capsys):
    path = tmp_path / "words.key"
    with pytest.raises(UserError, match=r"--passphrase: nobody answered; run this at a terminal"):
        CliRunner().invoke(app, ["key", str(path), "--passphrase"], input="", catch_exceptions=False)
    assert not path.exists()


def test_two_keys_are_different(tmp_path):
    for name in ("a", "b"):
        write_new_key(tmp_path / name)
    assert read_key(tmp_path / "a").reveal() != read_key(tmp_path / "b").reveal()


def test_check_warns_of_a_key_that_is_not_here(tmp_path):
    """It may be another computer's configuration, so nothing is wrong with it."""
    config = tmp_path / "vehicle.toml"
    text = bundled("serial.toml").read_text(encoding="utf-8")
    config.write_text(text + '\n[signing]\nkey_file = "vehicle.key"\n', encoding="utf-8")
    key, said = tmp_path / "vehicle.key", CliRunner().invoke(app, ["check", str(config)])
    assert said.exit_code == 0
    missing = f"no such file; make one with: kffa-offboard key {key}"
    assert f"{config}: warning: signing key {key}: {missing}" in said.output
    write_new_key(key)
    assert "signing key" not in CliRunner().invoke(app, ["check", str(config)]).output
