"""The secret of MAVLink 2 signing, in a file that only its owner can read.

A file may hold 32 random bytes, the same as 64 hexadecimal digits or as base64 (Mission Planner shows it
so), or ``passphrase: WORDS``, of which SHA-256 is the key, as in MAVProxy and QGroundControl.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import os
import secrets
import stat
from pathlib import Path
from typing import NoReturn

from kffa_offboard.errors import UserError

KEY_SIZE = 32
PASSPHRASE = "passphrase:"

_LARGEST_FILE = 4096
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


class SigningKey:
    """32 secret bytes that show themselves nowhere: not printed, not copied into logs, not pickled."""

    __slots__ = ("_secret",)

    def __init__(self, secret: bytes) -> None:
        if len(secret) != KEY_SIZE or not any(secret):
            raise ValueError(f"a signing key has {KEY_SIZE} bytes that are not all 0")
        self._secret = bytes(secret)

    def reveal(self) -> bytes:
        """The secret itself, for computing signatures."""
        return self._secret

    def __repr__(self) -> str:
        return "SigningKey(secret)"

    def __reduce__(self) -> NoReturn:
        raise TypeError("a signing key is not written anywhere")


def key_of_passphrase(words: str) -> SigningKey:
    """SHA-256 of the words in UTF-8. Raises ValueError for none."""
    if not words:
        raise ValueError("the passphrase is empty")
    return SigningKey(hashlib.sha256(words.encode()).digest())


def read_key(path: Path) -> SigningKey:
    """Read a key file.

    Raises UserError, one line that never holds anything of the file's content: missing, readable by others,
    owned by somebody else, not a key.
    """
    try:
        with path.open("rb") as file:
            _check_owner(path, os.fstat(file.fileno()))
            content = file.read(_LARGEST_FILE + 1)
    except FileNotFoundError as error:
        raise UserError(
            f"signing key {path}: no such file; make one with: kffa-offboard key {path}"
        ) from error
    except OSError as error:
        raise UserError(
            f"signing key {path}: cannot be read: {error.strerror}; check path and permissions"
        ) from error
    secret = _secret_in(content)
    if secret is None or not any(secret):
        raise UserError(
            f"signing key {path}: is no key; it has to hold 32 bytes, 64 hexadecimal digits, base64 of 32 "
            f"bytes or '{PASSPHRASE} WORDS'"
        )
    return SigningKey(secret)


def write_new_key(path: Path, key: SigningKey | None = None) -> None:
    """Write a key, a random one if none is given, to a new file that only its owner can read.

    Raises UserError if the file exists or cannot be made.
    """
    secret = secrets.token_bytes(KEY_SIZE) if key is None else key.reveal()
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, stat.S_IRUSR | stat.S_IWUSR)
        with os.fdopen(descriptor, "w", encoding="ascii") as file:
            file.write(secret.hex() + "\n")
    except FileExistsError as error:
        raise UserError(
            f"signing key {path}: exists already; remove it first if no vehicle needs it"
        ) from error
    except OSError as error:
        raise UserError(f"signing key {path}: cannot be written: {error.strerror}; choose another") from error


def _check_owner(path: Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise UserError(f"signing key {path}: is not a regular file; name a file")
    if status.st_uid not in (os.geteuid(), 0):
        raise UserError(f"signing key {path}: belongs to another user; sudo chown $USER {path}")
    mode = stat.S_IMODE(status.st_mode)
    if mode & _OTHERS:
        raise UserError(f"signing key {path}: others can use it (mode {mode:04o}); chmod 600 {path}")


def _secret_in(content: bytes) -> bytes | None:
    """The 32 bytes that a file's content means; None if it means none."""
    if len(content) == KEY_SIZE and not content.isascii():
        return content  # 32 characters of text are a key cut short, not random bytes
    try:
        text = content.decode("utf-8").strip()
    except UnicodeDecodeError:
        return None
    if text.startswith(PASSPHRASE):
        words = text.removeprefix(PASSPHRASE).strip()
        return hashlib.sha256(words.encode()).digest() if words and len(content) <= _LARGEST_FILE else None
    for decode in (bytes.fromhex, _base64):
        try:
            secret = decode(text)
        except (ValueError, binascii.Error):
            continue
        if len(secret) == KEY_SIZE:
            return secret
    return None


def _base64(text: str) -> bytes:
    return base64.b64decode(text, validate=True)
