"""What the service is told and what it answers: the vocabulary between MAVLink and control.

Everything here is a value in the paper's axes (x north, y west, z up; roll, pitch and yaw
right-handed about them), SI units and radians. `mavlink/` translates to and from the wire;
nothing here knows MAVLink. Times are integer microseconds: `sample_time_us` is the
autopilot's own clock (for dt), the arrival time is given to the service beside the event
(for timeouts).
"""

from __future__ import annotations

from enum import Enum
from math import nan
from typing import Literal, TypeAlias

from msgspec import Struct

from kffa_offboard.offboard.settings import ServiceSettings

Vector3: TypeAlias = tuple[float, float, float]
Firmware: TypeAlias = Literal["px4", "ardupilot"]
ParameterSeverity: TypeAlias = Literal["unsafe", "warning", "information"]


class ModeKind(Enum):
    """What a flight mode means to an offboard controller, whatever the firmware calls it."""

    OFFBOARD = "offboard"  # PX4 OFFBOARD; ArduCopter GUIDED or GUIDED_NOGPS
    HOLD = "hold"  # PX4 Hold (AUTO.LOITER); ArduCopter BRAKE
    LAND = "land"
    OTHER = "other"


class Severity(Enum):
    """The four levels of a status text that the daemon uses (MAV_SEVERITY)."""

    CRITICAL = "critical"
    WARNING = "warning"
    NOTICE = "notice"
    INFO = "info"


# ---------------------------------------------------------------------------- events in


class HeartbeatReceived(Struct, frozen=True, gc=False):
    """The autopilot is alive: its firmware, flight mode and arming state.

    `killed`: its motors are stopped, by a kill switch (it is still armed) or for good.
    """

    firmware: Firmware
    mode: ModeKind
    mode_name: str
    custom_mode: int
    armed: bool
    killed: bool = False


class AttitudeReceived(Struct, frozen=True, gc=False):
    """Euler angles [rad] (roll, pitch, yaw) and body rates [rad/s] of one sample."""

    sample_time_us: int
    attitude: Vector3
    body_rates: Vector3


class PositionReceived(Struct, frozen=True, gc=False):
    """Position [m] and velocity [m/s] of one sample, relative to the estimator's origin, z up."""

    sample_time_us: int
    position: Vector3
    velocity: Vector3


class TargetReported(Struct, frozen=True, gc=False):
    """What the autopilot itself is commanding (ATTITUDE_TARGET); None where it is not to be trusted."""

    sample_time_us: int
    thrust: float | None
    body_rates: Vector3 | None
    attitude: Vector3 | None


class ThrottleReported(Struct, frozen=True, gc=False):
    """VFR_HUD throttle as a fraction 0..1, for firmware that reports no ATTITUDE_TARGET."""

    throttle: float


class LandedStateReported(Struct, frozen=True, gc=False):
    """EXTENDED_SYS_STATE: is the vehicle on the ground?"""

    on_ground: bool


class BatteryReported(Struct, frozen=True, gc=False):
    """SYS_STATUS: what is left in the battery, percent."""

    remaining_percent: float


class EstimateReported(Struct, frozen=True, gc=False):
    """What the autopilot says of its own estimate: which parts of it are valid.

    `height` stands for the climb rate, too, `position` for place and speed over ground.
    """

    attitude: bool
    height: bool
    position: bool


class CommandAnswered(Struct, frozen=True, gc=False):
    """COMMAND_ACK. `action` names the output it answers."""

    action: Literal["arm", "disarm", "mode", "message-rate", "gripper", "other"]
    command: int
    accepted: bool
    in_progress: bool
    result_name: str


class StatusReceived(Struct, frozen=True, gc=False):
    """STATUSTEXT of the autopilot, for the log."""

    severity: int
    text: str


class ParameterProblem(Struct, frozen=True, gc=False):
    """What is wrong with one of the autopilot's parameters, and what to set. "unsafe" forbids engaging."""

    name: str
    severity: ParameterSeverity
    text: str


class ParametersChecked(Struct, frozen=True, gc=False):
    """The autopilot's parameters were judged; `complete` is False while they are being read."""

    problems: tuple[ParameterProblem, ...]
    complete: bool = True


class EngageRequested(Struct, frozen=True, gc=False):
    """Somebody (the command line or a MAVLink command) asks the daemon to take control."""


class ReleaseRequested(Struct, frozen=True, gc=False):
    """Somebody asks the daemon to give control back; with `stay` it may be asked to engage again."""

    reason: str
    stay: bool = False


class GripperRequested(Struct, frozen=True, gc=False):
    """Somebody asks the daemon to grab or release the load."""

    action: Literal["grab", "release"]


class SettingsChanged(Struct, frozen=True, gc=False):
    """Other numbers from now on; what the controller remembers stays."""

    settings: ServiceSettings


class LinkMeasured(Struct, frozen=True, gc=False):
    """The autopilot's clock less ours [us], and how long a message and its answer take [s]."""

    clock_offset_us: int
    round_trip_s: float


class IntrusionNoticed(Struct, frozen=True, gc=False):
    """Somebody is on the link who should not be, and what follows.

    It is "said"; or it "forbids" engaging, too; or, if it goes on, it "ends" control, too.
    """

    text: str
    consequence: Literal["said", "forbids", "ends"]


class GiveUpRequested(Struct, frozen=True, gc=False):
    """The run ends without waiting longer: last words, and the vehicle's parameters are put back."""


class HangNoticed(Struct, frozen=True, gc=False):
    """The daemon stood still for so long (stopped, or without a processor) that it has lost control."""

    seconds: float


class PositionSetpoint(Struct, frozen=True, gc=False):
    """Go to x, y and z [m] from the estimator's origin, heading `yaw` [rad]; None leaves it as it is.

    x and y come together or not at all.
    """

    position: tuple[float | None, float | None, float | None]
    yaw: float | None = None


class AttitudeSetpoint(Struct, frozen=True, gc=False):
    """Fly with this attitude [rad]; the height is held."""

    attitude: Vector3


Event: TypeAlias = (
    HeartbeatReceived
    | AttitudeReceived
    | PositionReceived
    | TargetReported
    | ThrottleReported
    | LandedStateReported
    | BatteryReported
    | EstimateReported
    | CommandAnswered
    | StatusReceived
    | ParametersChecked
    | EngageRequested
    | ReleaseRequested
    | GripperRequested
    | SettingsChanged
    | LinkMeasured
    | IntrusionNoticed
    | GiveUpRequested
    | HangNoticed
    | PositionSetpoint
    | AttitudeSetpoint
)

# ---------------------------------------------------- what the daemon's own process reports


class StepTiming(Struct, frozen=True, gc=False):
    """How punctual the control loop is.

    Control steps since the start, those that were late, other deadlines that were late, and the longest
    delay since the report before this one, s.
    """

    steps: int
    late_steps: int
    late_deadlines: int
    longest_s: float


class Trouble(Struct, frozen=True, gc=False):
    """Something beside the flight that people should know of: a full disk, an unplugged cable."""

    text: str


ProcessReport: TypeAlias = StepTiming | Trouble
"""For the log and for whoever listens; the service is not told."""

# --------------------------------------------------------------------------- messages out


class AttitudeTarget(Struct, frozen=True, gc=False):
    """One setpoint. Exactly one of `body_rates` [rad/s] and `attitude` [rad] is given.

    `thrust` is normalised collective thrust 0..1.
    """

    thrust: float
    body_rates: Vector3 | None = None
    attitude: Vector3 | None = None


class RequestMessageRates(Struct, frozen=True, gc=False):
    """Ask for telemetry: event class name -> Hz."""

    attitude_hz: float
    position_hz: float
    target_hz: float
    status_hz: float
    heartbeat_hz: float = 5.0


class SetMode(Struct, frozen=True, gc=False):
    """Ask the autopilot for a flight mode."""

    mode: ModeKind


class SetArmed(Struct, frozen=True, gc=False):
    """Ask the autopilot to arm or to disarm. Never forced."""

    armed: bool


class SetGripper(Struct, frozen=True, gc=False):
    """Work the payload gripper (MAV_CMD_DO_GRIPPER)."""

    action: Literal["grab", "release"]


class Announce(Struct, frozen=True, gc=False):
    """A line for people: STATUSTEXT (50 characters or fewer there) and a line in the log."""

    severity: Severity
    text: str


class RequestRefused(Struct, frozen=True, gc=False):
    """What was just asked is not done; `final` if asking again cannot help. For whoever asked."""

    reason: str
    final: bool = False


class OwnHeartbeat(Struct, frozen=True, gc=False):
    """The daemon's own heartbeat (component 191)."""

    state: Literal["standby", "active", "critical"]


class Signals(Struct, frozen=True, gc=False):
    """Inner signals of one control step, for the log and for live graphs.

    Each tuple is in channel order roll, pitch, yaw, altitude. `time_us` is the event's
    arrival time; `command` is what was sent (or, in shadow, what would have been). `latency_s` is the
    time from taking the sample until the autopilot has the command; NaN while clocks are not compared.
    `position_reference` is where the position ring wants to be, x and y [m], None without one.
    """

    time_us: int
    state: str
    reference: tuple[float, ...]
    reference_rate: tuple[float, ...]
    measurement: tuple[float, ...]
    estimate: tuple[float, ...]
    estimate_rate: tuple[float, ...]
    disturbance: tuple[float, ...]
    omega_c: tuple[float, ...]
    command: tuple[float, ...]
    applied: tuple[float, ...]
    saturated: tuple[bool, ...] = (False, False, False, False)
    dt: float = 0.0
    latency_s: float = nan
    position_reference: tuple[float, float] | None = None


class PayloadReport(Struct, frozen=True, gc=False):
    """Estimated mass of the load and its standard deviation, kg. `time_us` is the arrival time."""

    time_us: int
    mass_kg: float
    std_kg: float


Output: TypeAlias = (
    AttitudeTarget
    | RequestMessageRates
    | SetMode
    | SetArmed
    | SetGripper
    | Announce
    | RequestRefused
    | OwnHeartbeat
    | Signals
    | PayloadReport
)
