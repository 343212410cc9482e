"""MAVSDK, as people install it, flies the simulated vehicle: over UDP, in real time, with either firmware.

Needs the extra "clients".
"""

from __future__ import annotations

import asyncio
import contextlib
import csv
from collections.abc import AsyncGenerator, Callable
from pathlib import Path
from typing import Any

import pytest

from sim_vehicle.config import SimConfig, load

pytest.importorskip(
    "mavsdk", reason='extra "clients" is not installed: no MAVSDK; pip install "kffa-offboard[clients]"'
)

from mavsdk import Autopilot, ComponentType, Configuration
from mavsdk.asyncio import Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.offboard import AttitudeRate
from mavsdk.plugins.telemetry import FlightMode, LandedState

CONFIGS = Path(__file__).parents[2] / "configs"
HEIGHT = 2.0
HOVER_THRUST = 0.3984
PATIENCE_S = 30.0
AUTOPILOTS = {"px4": Autopilot.PX4, "ardupilot": Autopilot.ARDUPILOT}
WHOLE = {"px4": ("COM_OBL_RC_ACT", 4), "ardupilot": ("LAND_SPEED", 100)}
FRACTION = {"px4": ("MPC_LAND_SPEED", 1.0), "ardupilot": ("GUID_TIMEOUT", 0.75)}


async def until(
    what: str, stream: AsyncGenerator[Any, None], wanted: Callable[[Any], bool] = lambda value: True
) -> Any:
    """The first value of a subscription that is wanted; the test fails if none comes."""
    last = None
    try:
        async with asyncio.timeout(PATIENCE_S), contextlib.aclosing(stream):
            async for last in stream:
                if wanted(last):
                    return last
    except TimeoutError:
        pytest.fail(f"{what}: not within {PATIENCE_S:g} s; the last that came was {last}")


class Client:
    """MAVSDK's plugins for one vehicle."""

    def __init__(self, system: Any) -> None:
        self.system = system
        self.action = ActionAsync(system)
        self.offboard = OffboardAsync(system)
        self.parameters = ParamAsync(system)
        self.telemetry = TelemetryAsync(system)

    async def mode_is(self, mode: FlightMode) -> None:
        await until(mode.name, self.telemetry.subscribe_flight_mode(), lambda value: value == mode)

    async def landed_state_is(self, state: LandedState) -> None:
        await until(state.name, self.telemetry.subscribe_landed_state(), lambda value: value == state)

    async def armed_is(self, armed: bool) -> None:
        await until(f"armed {armed}", self.telemetry.subscribe_armed(), lambda value: value == armed)


async def check_telemetry(client: Client) -> None:
    """Everything that a program asks for first is there, and makes sense for a vehicle on the ground."""
    telemetry = client.telemetry
    await until("all health", telemetry.subscribe_health_all_ok(), bool)
    position, attitude, battery, in_air = await asyncio.gather(
        until("position", telemetry.subscribe_position()),
        until("attitude", telemetry.subscribe_attitude_euler()),
        until("battery", telemetry.subscribe_battery()),
        until("in air", telemetry.subscribe_in_air()),
    )
    assert position.absolute_altitude_m == pytest.approx(488.0, abs=0.2)
    assert position.relative_altitude_m == pytest.approx(0.0, abs=0.2)
    assert (attitude.roll_deg, attitude.pitch_deg) == pytest.approx((0.0, 0.0), abs=1.0)
    assert battery.voltage_v == pytest.approx(23.1)
    assert battery.remaining_percent == 90.0
    assert not in_air
    await client.landed_state_is(LandedState.ON_GROUND)
    await client.armed_is(False)


async def check_parameters(client: Client, settings: SimConfig) -> None:
    """The list is complete, with the right values; a change is kept, for either type."""
    store = settings.make_parameters()
    received = await client.parameters.get_all_params()
    values = {item.name: item.value for item in (*received.int_params, *received.float_params)}
    assert values == {name: pytest.approx(store[name], rel=1e-6) for name in store.names}
    whole = {name for name in store.names if store.kind(name) != "real32"}
    assert {item.name for item in received.int_params} == whole

    name, whole_number = WHOLE[settings.vehicle.personality]
    await client.parameters.set_param_int(name, whole_number)
    assert await client.parameters.get_param_int(name) == whole_number
    name, fraction = FRACTION[settings.vehicle.personality]
    await client.parameters.set_param_float(name, fraction)
    assert await client.parameters.get_param_float(name) == fraction


async def fly(client: Client) -> None:
    """Arm, take off, turn by body rates, land, disarm."""
    telemetry = client.telemetry
    await client.action.set_takeoff_altitude(HEIGHT)
    await client.action.arm()
    await client.armed_is(True)
    await client.action.takeoff()
    await until("in air", telemetry.subscribe_in_air(), bool)
    await until(
        "hover",
        telemetry.subscribe_position_velocity_ned(),
        lambda now: abs(now.position.down_m + HEIGHT) < 0.3 and abs(now.velocity.down_m_s) < 0.2,
    )
    await client.offboard.set_attitude_rate(AttitudeRate(0.0, 0.0, 40.0, HOVER_THRUST))
    await client.offboard.start()
    await client.mode_is(FlightMode.OFFBOARD)
    await until("turn", telemetry.subscribe_attitude_euler(), lambda now: now.yaw_deg > 20.0)
    await client.offboard.stop()
    assert not await client.offboard.is_active()
    await client.mode_is(FlightMode.HOLD)
    await client.action.land()
    await client.mode_is(FlightMode.LAND)
    await client.landed_state_is(LandedState.ON_GROUND)
    await client.action.disarm()
    await client.armed_is(False)


async def session(address: str, settings: SimConfig) -> None:
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
        await mavsdk.add_any_connection(address)
        system = await mavsdk.first_autopilot(timeout_s=PATIENCE_S)
        assert system is not None
        assert await system.autopilot_type() == AUTOPILOTS[settings.vehicle.personality]
        client = Client(system)
        await check_telemetry(client)
        await check_parameters(client, settings)
        await fly(client)


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_mavsdk_reads_everything_and_flies_the_vehicle(
    vehicle_process: Any, personality: str, tmp_path: Path
) -> None:
    truth = tmp_path / "truth.csv"
    settings = load(CONFIGS / f"sim-{personality}.toml")
    with vehicle_process(personality, "udp", truth) as at:
        asyncio.run(session(f"udpout://{at}", settings))
    with truth.open() as file:
        rows = list(csv.DictReader(file))
    assert HEIGHT - 0.3 < max(float(row["z"]) for row in rows) < HEIGHT + 2.0
    assert abs(float(rows[-1]["z"])) < 0.01
    happened = [event for row in rows for event in row["event"].split("; ")]
    order = [happened.index(event) for event in ("armed", "takeoff", "mode LAND", "landed", "disarmed")]
    assert order == sorted(order)
