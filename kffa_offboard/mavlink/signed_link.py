"""A link on which every frame is signed: signatures are put on going out, checked and taken off coming in.

Whoever uses it sees unsigned frames that are known to be genuine. So the flight log holds nothing that
could be sent to a signing vehicle again, and replaying it needs no key.
"""

from __future__ import annotations

import logging
import os
from collections import Counter, deque
from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path

from msgspec.structs import replace
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.signing import (
    EPOCH_US,
    LATEST,
    UNITS_PER_SECOND,
    Signer,
    Verdict,
    checksum_fits,
    frame_size,
    message_id,
    sender,
    timestamp_at,
    without_signature,
)
from kffa_offboard.mavlink.signing_key import read_key
from kffa_offboard.mavlink.transport import Clock, Datagram, Link, Posting

LOG = logging.getLogger(__name__)

SIK_RADIO = (ord("3"), ord("D"))
"""Telemetry radios put in RADIO_STATUS themselves, unsigned, under these ids; only the log takes it."""

MOST_REASONS = 50
"""So many different refusals (verdict and sender) are counted apart and said; the rest go together."""

EARLIEST_US = EPOCH_US + 9 * 365 * 86_400 * 1_000_000
"""A clock that is before (December 2023) was never set."""

ECHOES = 256
"""So many frames of ours are remembered: a link that sends them back at once is not worth a word."""

_HEAD_SIZE = 3


@dataclass(frozen=True, slots=True)
class SigningSettings:
    """Where the key is, which link this is (0..255), and where the newest timestamp is kept between runs."""

    key_file: Path
    link_id: int = 0
    timestamp_file: Path | None = None


def sign_link(link: Link, settings: SigningSettings, clock: Clock) -> SignedLink:
    """Sign on `link`; `clock` tells UNIX time. Raises UserError for a bad key or timestamp file."""
    key = read_key(settings.key_file)
    stored = _read_timestamp(settings.timestamp_file)
    signer = Signer(key, settings.link_id, stored)
    opened = SignedLink(link, signer, Signer(key), clock, settings.timestamp_file)
    problem = clock_problem(clock(), stored)
    if problem is not None:
        LOG.warning("%s", problem)
    opened.remember()
    return opened


def clock_problem(now_us: int, stored: int) -> str | None:
    """What is wrong with this computer's clock, one line, as far as it can be told."""
    if now_us < EARLIEST_US:
        return (
            "signing: this computer's clock is not set (it says a day before 2024); set it, or the vehicle "
            "may refuse what we send until a signed message of its own has told the time"
        )
    behind_s = (stored - timestamp_at(now_us)) / UNITS_PER_SECOND
    if behind_s > 60.0:
        return (
            f"signing: this computer's clock is {_spoken(behind_s)} behind the last flight; "
            "signatures go on from there, set the clock"
        )
    return None


class SignedLink:
    """`transport.Link` around another one. Every datagram holds whole frames, whatever the link is.

    Attributes
    ----------
    refused : how many frames of which kind were refused: (verdict, sender) -> number
    """

    keeps_frames_whole = True

    def __init__(
        self, link: Link, signer: Signer, strangers: Signer, clock: Clock, timestamp_file: Path | None = None
    ) -> None:
        self._link = link
        self._signer = signer
        self._spare = signer.beside()
        self._strangers = strangers  # what they send must not make the vehicle's own frames look old
        self._clock = clock
        self._timestamp_file = timestamp_file
        self._source: Hashable = None
        self._buffer = b""
        self._news = ""
        self._sent: deque[bytes] = deque(maxlen=ECHOES)
        self._ahead_said: set[tuple[int, int]] = set()
        self.refused: Counter[tuple[Verdict, tuple[int, int]]] = Counter()

    @property
    def name(self) -> str:
        """See `transport.Link`."""
        return self._link.name

    @property
    def descriptor(self) -> int | None:
        """See `transport.Link`."""
        return self._link.descriptor

    def take_news(self) -> str | None:
        """See `transport.Link`."""
        return self._link.take_news()

    @property
    def trouble(self) -> str:
        """See `transport.Link`; what was refused, if nothing else is wrong."""
        return self._link.trouble or self.refusals()

    def refusals(self) -> str:
        """What was refused so far, for people; empty if nothing was."""
        said = [
            f"{number} from {system}/{component} refused: {verdict.value}"
            for (verdict, (system, component)), number in self.refused.most_common(3)
        ]
        return "signing: " + ", ".join(said) if said else ""

    def receive(self, timeout_s: float) -> list[Datagram]:
        """See `transport.Link`."""
        checked: list[Datagram] = []
        for datagram in self._link.receive(timeout_s):
            self._news = ""
            data = self._genuine(datagram)
            if data or self._news:
                checked.append(replace(datagram, data=data, notice=self._news))
        return checked

    def send(self, data: bytes) -> bool:
        """See `transport.Link`."""
        frames = [self._signer.sign(frame, self._clock()) for frame in _split(data)[0]]
        self._sent.extend(frames)
        if self._link.keeps_frames_whole:
            return self._link.send(b"".join(frames))
        return all([self._link.send(frame) for frame in frames])

    def posting(self, data: bytes) -> Posting | None:
        """See `transport.Link`. Signed as on another link, or what goes out here would make it look old."""
        self._spare.timestamp = max(self._spare.timestamp, self._signer.timestamp)
        frames = [self._spare.sign(frame, self._clock()) for frame in _split(data)[0]]
        return self._link.posting(b"".join(frames))

    def lock(self, source: Hashable) -> None:
        """See `transport.Link`."""
        self._link.lock(source)

    def close(self) -> None:
        """See `transport.Link`."""
        self.remember()
        self._link.close()

    def remember(self) -> None:
        """Keep the newest timestamp for the next run. Raises UserError if it cannot be written."""
        if self._timestamp_file is None:
            return
        newest = max(self._signer.timestamp, timestamp_at(self._clock()))
        temporary = self._timestamp_file.with_name(self._timestamp_file.name + ".new")
        try:
            temporary.write_text(f"{newest}\n", encoding="ascii")
            os.replace(temporary, self._timestamp_file)
        except OSError as error:
            raise UserError(
                f"signing.timestamp_file {self._timestamp_file}: cannot be written: {error.strerror}; "
                "choose another place"
            ) from error

    # ------------------------------------------------------------------------------ frames

    def _genuine(self, datagram: Datagram) -> bytes:
        """The genuine frames that are complete with a datagram, without their signatures."""
        fresh = self._link.keeps_frames_whole or datagram.source != self._source
        data = datagram.data if fresh else self._buffer + datagram.data
        self._source = datagram.source
        frames, self._buffer = _split(data)
        signer = self._strangers if datagram.stranger else self._signer
        now_us = self._clock()
        return b"".join(filter(None, (self._open(signer, now_us, frame) for frame in frames)))

    def _open(self, signer: Signer, time_us: int, frame: bytes) -> bytes | None:
        """A frame without its signature; None if it is refused."""
        verdict = signer.check(frame, time_us)
        if signer is self._strangers and verdict is Verdict.GENUINE and self._signer.knows_newer(frame):
            verdict = Verdict.REPLAYED
        if verdict is Verdict.GENUINE:
            self._compare_clocks(time_us, frame)
            return without_signature(frame)
        if not checksum_fits(frame) or frame in self._sent:
            return None  # damaged on the way, or an echo; nobody's fault
        radio = message_id(frame) == mavlink.MAVLINK_MSG_ID_RADIO_STATUS and sender(frame) == SIK_RADIO
        if radio and verdict is Verdict.UNSIGNED:
            return frame
        self._refuse(verdict, sender(frame))
        return None

    def _refuse(self, verdict: Verdict, source: tuple[int, int]) -> None:
        reason = (verdict, source)
        if reason not in self.refused:
            if len(self.refused) >= MOST_REASONS:
                reason = (verdict, (0, 0))
            if reason not in self.refused:
                self._news = f"refusing {source[0]}/{source[1]}: {verdict.value}"
                LOG.warning("signing: %s; %s", self._news, _REMEDY[verdict])
        self.refused[reason] += 1

    def _compare_clocks(self, time_us: int, frame: bytes) -> None:
        ahead_s = (int.from_bytes(frame[-12:-6], "little") - timestamp_at(time_us)) / UNITS_PER_SECOND
        if ahead_s > 60.0 and sender(frame) not in self._ahead_said:
            self._ahead_said.add(sender(frame))
            LOG.warning(
                "signing: the clock of %d/%d is %s ahead of this computer's; one of them is wrong",
                *sender(frame),
                _spoken(ahead_s),
            )


_REMEDY = {
    Verdict.UNSIGNED: "is signing on there?",
    Verdict.FORGED: "has it the same key?",
    Verdict.REPLAYED: "messages come twice or in another order, or somebody sends recorded ones",
    Verdict.OUTDATED: "its clock is wrong, or somebody sends recorded messages",
    Verdict.ENDLESS: "its clock or its stored timestamp is wrong; from there nobody could go on",
}


def _split(data: bytes) -> tuple[list[bytes], bytes]:
    """Whole frames in `data`, and the beginning of one that may go on; what is neither is left out."""
    frames: list[bytes] = []
    at, end = 0, len(data)
    while at < end:
        if end - at < _HEAD_SIZE:
            break
        size = frame_size(data[at : at + _HEAD_SIZE])
        if size is None:
            at = _next_marker(data, at + 1)
        elif end - at < size:
            break
        else:
            frames.append(data[at : at + size])
            at += size
    return frames, data[at:]


def _next_marker(data: bytes, at: int) -> int:
    places = [place for place in (data.find(0xFD, at), data.find(0xFE, at)) if place >= 0]
    return min(places, default=len(data))


def _read_timestamp(path: Path | None) -> int:
    if path is None:
        return 0
    try:
        text = path.read_text(encoding="ascii").strip()
        if not text.isdigit() or len(text) > 15:
            raise ValueError
        if int(text) > LATEST:
            raise ValueError
        return int(text)
    except FileNotFoundError:
        return 0
    except ValueError as error:
        raise UserError(
            f"signing.timestamp_file {path}: holds no timestamp; remove it if this computer's clock is right"
        ) from error
    except OSError as error:
        raise UserError(f"signing.timestamp_file {path}: cannot be read: {error.strerror}") from error


def _spoken(seconds: float) -> str:
    for unit, length in (("days", 86_400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2.0 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds:.0f} seconds"
