"""The daemon's link in lock-step with faults on it; a `mavlink.transport.Link` around another one."""

from __future__ import annotations

from collections.abc import Hashable

from msgspec.structs import replace

from kffa_offboard.faults.barrier import BarrierFaults
from kffa_offboard.mavlink.transport import Datagram, Link, Posting


class FaultyLink:
    """A link whose vehicle flies in lock-step; `faults` holds both directions, and the time."""

    def __init__(self, link: Link, faults: BarrierFaults) -> None:
        self.inner = link
        self.faults = faults

    @property
    def name(self) -> str:
        """See `transport.Link`."""
        return self.inner.name

    @property
    def keeps_frames_whole(self) -> bool:
        """See `transport.Link`."""
        return self.inner.keeps_frames_whole

    @property
    def trouble(self) -> str:
        """See `transport.Link`."""
        return self.inner.trouble

    @property
    def descriptor(self) -> int | None:
        """See `transport.Link`."""
        return self.inner.descriptor

    def take_news(self) -> str | None:
        """See `transport.Link`."""
        return self.inner.take_news()

    def receive(self, timeout_s: float) -> list[Datagram]:
        """See `transport.Link`."""
        return [
            replace(datagram, data=data)
            for datagram in self.inner.receive(timeout_s)
            for data in self.faults.from_vehicle(datagram.data)
        ]

    def send(self, data: bytes) -> bool:
        """See `transport.Link`. What a fault keeps counts as sent."""
        return all([self.inner.send(passed) for passed in self.faults.from_daemon(data)])

    def posting(self, data: bytes) -> Posting | None:
        """See `transport.Link`; nobody sends in this one's place."""
        return None

    def lock(self, source: Hashable) -> None:
        """See `transport.Link`."""
        self.inner.lock(source)

    def close(self) -> None:
        """See `transport.Link`."""
        self.inner.close()
