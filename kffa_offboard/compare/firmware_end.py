"""Our end of a firmware's MAVLink link (UDP): who is there, and a hand on its gripper."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.compare.plan import DROP_S, PICKUP_S, AutopilotName, CourseName
from kffa_offboard.errors import UserError
from kffa_offboard.mavlink import commands
from kffa_offboard.mavlink.address import NetworkAddress, check_url
from kffa_offboard.mavlink.component import Component, FrameParser, Message, Route
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.mavlink.udp import UdpLink
from kffa_offboard.offboard.events import SetGripper

AUTOPILOTS: dict[int, AutopilotName] = {
    mavlink.MAV_AUTOPILOT_PX4: "px4",
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ardupilot",
}
GROUND_STATION = (255, mavlink.MAV_COMP_ID_MISSIONPLANNER)
SMOOTHING = 0.02
"""Share of the latest climb rate in the mean."""

AIRBORNE_M = 0.1
"""As the physics' own schedule: lift-off is when it is first this high."""

_COMING_AND_GOING: dict[CourseName, tuple[tuple[float, SetGripper], ...]] = {
    "load": ((PICKUP_S, SetGripper("grab")), (DROP_S, SetGripper("release"))),
    "release": ((PICKUP_S, SetGripper("grab")),),
    "attitude": (),
}


@dataclass(frozen=True)
class Identity:
    """Who flies the vehicle: MAVLink system id and autopilot."""

    system_id: int
    autopilot: AutopilotName


class Hand:
    """Works the gripper of a firmware as a ground station does: the load of a trial comes and goes by it.

    Sans-I/O; time is the vehicle's own. The gripper is opened first, and once.
    """

    def __init__(self, course: CourseName) -> None:
        self._left = list(_COMING_AND_GOING[course])
        self._opened = False
        self._armed = False
        self._ground_m = 0.0
        self._lifted_s: float | None = None

    def see(self, message: Message) -> list[SetGripper]:
        """Take one message of the vehicle; what the gripper is to do now."""
        kind = message.get_type()
        if kind == "HEARTBEAT":
            self._armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        if kind != "LOCAL_POSITION_NED":
            return []
        now_s, height_m = message.time_boot_ms * 1e-3, -message.z
        if not self._armed and self._lifted_s is None:
            self._ground_m = height_m
        elif self._lifted_s is None and height_m - self._ground_m > AIRBORNE_M:
            self._lifted_s = now_s
        if not self._opened:
            self._opened = True
            return [SetGripper("release")]
        if self._lifted_s is None or not self._left or now_s - self._lifted_s < self._left[0][0]:
            return []
        return [self._left.pop(0)[1]]


class FirmwareEnd:
    """A UDP end on which one firmware is met.

    Attributes
    ----------
    port : ours, if we listen
    identity : of the autopilot, from its first HEARTBEAT on
    armed : as the autopilot said last
    climb_rate_m_s : likewise, a mean over the last second or so; 0 if it does not say
    hand : on the gripper; None if the load comes and goes otherwise

    Raises UserError if `url` is not one for UDP or cannot be opened.
    """

    def __init__(self, url: str = "udpin:127.0.0.1:0") -> None:
        address = check_url(url, allow_remote=False)
        if not isinstance(address, NetworkAddress) or address.kind not in ("udpin", "udpout"):
            raise UserError(
                f"--join {url}: the firmware is met over UDP; write udpin:HOST:PORT (it sends there, as to a "
                "ground station) or udpout:HOST:PORT (it listens there)"
            )
        self._link = UdpLink(address, lambda: 0)
        self.port = int(self._link.name.rpartition(":")[2])
        self._parser = FrameParser(keeps_frames_whole=True)
        self._station = Component(Route(*GROUND_STATION))
        self._latest: Hashable | None = None
        self.identity: Identity | None = None
        self.armed = False
        self.climb_rate_m_s = 0.0
        self.hand: Hand | None = None

    def fileno(self) -> int:
        """For `select`."""
        return self._link.fileno()

    def receive(self) -> list[Message]:
        """What has come, without waiting; the hand acts upon it."""
        messages: list[Message] = []
        while datagrams := self._link.receive(0.0):
            for datagram in datagrams:
                messages += self._read(datagram)
        for message in messages:
            if self.identity is not None and message.get_srcSystem() == self.identity.system_id:
                self._take(message)
        return messages

    def _take(self, message: Message) -> None:
        hand = self.hand
        if hand is not None:
            self._work_gripper(hand.see(message))
        if message.get_type() == "HEARTBEAT" and message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1:
            self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        elif message.get_type() == "LOCAL_POSITION_NED":
            self.climb_rate_m_s += SMOOTHING * (-float(message.vz) - self.climb_rate_m_s)

    def _read(self, datagram: Datagram) -> list[Message]:
        messages = self._parser.parse(datagram)
        self._latest = datagram.source
        for message in messages:
            if self.identity is None and message.get_type() == "HEARTBEAT":
                self._meet(message, datagram.source)
        return messages

    def _meet(self, heartbeat: Message, source: Hashable) -> None:
        name = AUTOPILOTS.get(heartbeat.autopilot)
        if name is not None and heartbeat.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1:
            self.identity = Identity(heartbeat.get_srcSystem(), name)
            self._link.lock(source)

    def _work_gripper(self, actions: list[SetGripper]) -> None:
        assert self.identity is not None
        route = Route(*GROUND_STATION, target_system=self.identity.system_id)
        for action in actions:
            self.send(self._station.pack(commands.set_gripper(route, action)))

    def greet(self) -> None:
        """Say that somebody is here, for a firmware that waits to be spoken to."""
        heartbeat = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
        )
        self.send(self._station.pack(heartbeat))

    def send(self, data: bytes) -> None:
        """Send whole frames to the firmware, or, before it was met, to whoever spoke last."""
        if self.identity is None:
            self._link.lock(self._latest)
        self._link.send(data)
        if self.identity is None:
            self._link.lock(None)

    def close(self) -> None:
        """Release the port."""
        self._link.close()
