"""The numbers of payload awareness and of a commanded release."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from kffa_offboard.control.payload import PayloadParameters


@dataclass(frozen=True, slots=True)
class PayloadSettings:
    """What the service is told about loads.

    Attributes
    ----------
    estimator : vehicle, actuator, noise and detection (`control.payload`)
    max_load_kg : a heavier load is announced; None: any load is right
    report_hz : how often the load's mass is reported
    settle_s : from lift-off, or from engaging in the air, to the first estimate that counts
    announce_s : from noticing a pick-up, or a drop of a part, to naming its mass, which needs the time to
        become exact
    gripper_open_s : from the gripper's command at the autopilot to the load's leaving; with it a commanded
        release steps the thrust at that moment, None leaves the release to the observer
    release_timeout_s : a commanded release that is not seen so long after its moment is announced
    """

    estimator: PayloadParameters
    max_load_kg: float | None = None
    report_hz: float = 5.0
    settle_s: float = 1.0
    announce_s: float = 0.4
    gripper_open_s: float | None = None
    release_timeout_s: float = 1.0

    def __post_init__(self) -> None:
        for name in ("max_load_kg", "report_hz", "settle_s", "announce_s", "release_timeout_s"):
            value = getattr(self, name)
            if value is not None and not (isfinite(value) and value > 0.0):
                raise ValueError(f"payload.{name} = {value}: must be positive and finite")
        opening = self.gripper_open_s
        if opening is not None and not 0.0 <= opening <= 5.0:
            raise ValueError(f"payload.gripper_open_s = {opening}: must be 0 to 5 s")
