"""The least that can be done with MAVSDK-Python: attitude in, set_attitude_rate out. Argument: port.

MAVSDK itself repeats the last setpoint 20 times a second; the timer starts anew with each one.
"""

from __future__ import annotations

import asyncio
import sys

from mavsdk import ComponentType, Configuration
from mavsdk.asyncio import Mavsdk
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.offboard import AttitudeRate

PATIENCE_S = 30.0


async def main(port: int) -> None:
    """Answer every attitude until killed."""
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER)) as mavsdk:
        await mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = await mavsdk.first_autopilot(timeout_s=PATIENCE_S)
        if system is None:
            raise SystemExit(f"error: no autopilot within {PATIENCE_S:g} s")
        offboard = OffboardAsync(system)
        async for _ in TelemetryAsync(system).subscribe_attitude_angular_velocity_body():
            await offboard.set_attitude_rate(AttitudeRate(0.0, 0.0, 0.0, 0.4))


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1])))
