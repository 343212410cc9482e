"""Several vehicles and other components on one link: only the configured one counts."""

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config import bundled
from kffa_offboard.mavlink.parameter_file import ParameterFile
from kffa_offboard.mavlink.transport import Datagram
from sim_vehicle import config as sim_config
from sim_vehicle.vehicle import SimulatedVehicle

GIMBAL, CAMERA = 154, 100


def other_vehicle(personality):
    """System 2, with another seed."""
    changes = {"vehicle": {"seed": 5, "system_id": 2}}
    return SimulatedVehicle(sim_config.load(bundled(f"demo-{personality}-vehicle.toml"), changes))


class Chatter:
    """What else a shared link carries: another vehicle that answers us, a gimbal and a camera of our own."""

    def __init__(self, other):
        self.other = other
        self.other.add_peer("daemon")
        self.components = [
            mavlink.MAVLink(None, srcSystem=1, srcComponent=component) for component in (GIMBAL, CAMERA)
        ]
        self.count = 0

    def frames(self, time_us):
        """Everything that the others say up to `time_us`, and lies that must not be believed."""
        self.count += 1
        self.other.advance(time_us)
        frames = [data for _, data in self.other.outgoing()]
        if self.count % 10 == 0:
            frames.append(self.other.time_request("daemon"))
            frames += [self.pack_of(packer, k) for packer in self.components for k in range(4)]
            frames += [self.lie(k) for k in range(3)]
        return frames

    @staticmethod
    def pack_of(packer, k):
        """Our own vehicle's system id, another component: heartbeat, answers, attitude."""
        message = (
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_GIMBAL, mavlink.MAV_AUTOPILOT_INVALID, 128, 0, 4, 3
            ),
            mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 4, 0, 0, 245, 191),
            mavlink.MAVLink_attitude_message(1, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0),
            mavlink.MAVLink_timesync_message(0, 10**15),
        )[k]
        return bytes(message.pack(packer))

    @staticmethod
    def lie(k):
        """The other vehicle answers commands and requests that were not for it."""
        message = (
            mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_DO_SET_MODE, 4, 0, 0, 245, 191),
            mavlink.MAVLink_param_value_message(b"GUID_OPTIONS", 0.0, 9, 100, 1),
            mavlink.MAVLink_heartbeat_message(2, 3, 1, 5, 4, 3),
        )[k]
        return bytes(message.pack(mavlink.MAVLink(None, srcSystem=2, srcComponent=1)))


def crowded(link_class, chatter):
    """The lock-step link with the others' frames between our vehicle's."""

    class CrowdedLink(link_class):
        def receive(self, timeout_s):
            own = super().receive(timeout_s)
            theirs = [
                Datagram(self.vehicle.time_us, frame, "vehicle")
                for frame in chatter.frames(self.vehicle.time_us)
            ]
            *telemetry, barrier = own
            mixed = [item for pair in zip(telemetry, theirs, strict=False) for item in pair]
            rest = telemetry[len(theirs) :] + theirs[len(telemetry) :]
            return [*mixed, *rest, barrier]

        def send(self, data):
            chatter.other.receive(data, "daemon")
            return super().send(data)

    return CrowdedLink


def flown(lock_step_flight, record, personality, chatter=None):
    flight = lock_step_flight(personality)
    flight.check_parameters(record)
    if chatter is not None:
        flight.link_to = crowded(flight.link_to, chatter)
    result = flight.fly(lambda vehicle: vehicle.state.rigid[2] > 0.2)
    return flight, result


def check(lock_step_flight, tmp_path, personality):
    record = ParameterFile(tmp_path / "changed.json")
    alone, _ = flown(lock_step_flight, record, personality)
    chatter = Chatter(other_vehicle(personality))
    together, result = flown(lock_step_flight, record, personality, chatter)
    assert together.link.sent == alone.link.sent
    assert result.stopped
    assert not chatter.other.firmware.armed
    assert chatter.other.state.rigid[2] < 0.01
    assert together.session.heard >= {(1, 1), (2, 1), (1, GIMBAL), (1, CAMERA)}


def test_another_px4_on_the_link_changes_no_byte_of_what_is_sent(lock_step_flight, tmp_path):
    check(lock_step_flight, tmp_path, "px4")


def test_another_arducopter_on_the_link_changes_no_byte_of_what_is_sent(lock_step_flight, tmp_path):
    check(lock_step_flight, tmp_path, "ardupilot")
