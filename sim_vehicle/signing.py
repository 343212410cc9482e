"""MAVLink 2 signing of the simulated autopilot: pymavlink's own, with the key from a file.

One thing is mended: pymavlink remembers the time of a frame before it has checked its signature, so that one
forged frame would shut the true sender out.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import os
import stat
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_vehicle.errors import SimulatorError

EPOCH_US = 1_420_070_400_000_000
"""2015-01-01, from where signatures count time, in steps of 10 us."""

_PASSPHRASE = "passphrase:"
_LARGEST_FILE = 4096


def wall_clock_us() -> int:
    """UNIX time."""
    return time.time_ns() // 1000


@dataclass(frozen=True, slots=True)
class Signing:
    """The key, which is not shown, and the clock that dates signatures (UNIX time, us)."""

    key: bytes = field(repr=False)
    clock: Callable[[], int] = wall_clock_us


class SignedMavlink(mavlink.MAVLink):  # type: ignore[misc]
    """A codec that signs what it packs and takes nothing that is not signed."""

    def __init__(self, system_id: int, component_id: int, signing: Signing, link_id: int) -> None:
        super().__init__(file=None, srcSystem=system_id, srcComponent=component_id)
        self._clock = signing.clock
        self.signing.secret_key = signing.key
        self.signing.sign_outgoing = True
        self.signing.link_id = link_id % 255

    def keep_time(self) -> None:
        """Let the timestamp follow the clock; call before packing and parsing."""
        self.signing.timestamp = max(self.signing.timestamp, (self._clock() - EPOCH_US) // 10)

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:
        """As pymavlink, but what is not genuine leaves no trace."""
        stamps = self.signing.stream_timestamps
        stream = (msgbuf[-13], srcSystem, srcComponent)
        before = stamps.get(stream)
        genuine = bool(super().check_signature(msgbuf, srcSystem, srcComponent))
        if not genuine and before is None:
            stamps.pop(stream, None)
        elif not genuine:
            stamps[stream] = before
        return genuine


def read_key(path: Path) -> bytes:
    """32 bytes, raw, as 64 hexadecimal digits, as base64, or SHA-256 of ``passphrase: WORDS``.

    Raises SimulatorError, one line, if there is no such file, if others may read it, or if it is no key.
    """
    where = f"signing.key_file {path}"
    try:
        with path.open("rb") as file:
            mode = stat.S_IMODE(os.fstat(file.fileno()).st_mode)
            content = file.read(_LARGEST_FILE)
    except OSError as problem:
        reason = problem.strerror or str(problem)
        raise SimulatorError(f"{where}: cannot be read: {reason}; check the path") from problem
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise SimulatorError(f"{where}: others can use it (mode {mode:04o}); chmod 600 {path}")
    key = _key_in(content)
    if key is None or not any(key):
        raise SimulatorError(
            f"{where}: is no key; 32 bytes, 64 hexadecimal digits, base64 or '{_PASSPHRASE} WORDS'"
        )
    return key


def _key_in(content: bytes) -> bytes | None:
    if len(content) == 32 and not content.isascii():
        return content
    text = content.decode("utf-8", errors="replace").strip()
    if text.startswith(_PASSPHRASE):
        words = text.removeprefix(_PASSPHRASE).strip()
        return hashlib.sha256(words.encode()).digest() if words else None
    for decode in (bytes.fromhex, lambda value: base64.b64decode(value, validate=True)):
        try:
            key = decode(text)
        except (ValueError, binascii.Error):
            continue
        if len(key) == 32:
            return key
    return None
