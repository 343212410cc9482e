"""rotorpy's batched simulator with its batched SE3 controller: `rotorpy_batch.py FLIGHTS STEPS INTEGRATOR`.

Runs in an interpreter that has rotorpy, torch and torchdiffeq, and prints seconds (wall, processor) of the
loop alone: hover at a set point, no trajectory, no wind and no sensors, on one thread.
"""

from __future__ import annotations

import json
import sys
import time

import torch
from rotorpy.controllers.quadrotor_control import BatchedSE3Control
from rotorpy.vehicles.crazyflie_params import quad_params
from rotorpy.vehicles.multirotor import BatchedMultirotor, BatchedMultirotorParams

STEP_S = 0.01
HOVER_RAD_S = 1788.53  # of a rotor


def main(flights: int, steps: int, integrator: str) -> None:
    """Fly, from half a metre beside the set point."""
    torch.set_num_threads(1)
    device = torch.device("cpu")
    parameters = BatchedMultirotorParams([dict(quad_params)] * flights, flights, device)

    def repeated(*values: float) -> torch.Tensor:
        return torch.tensor(values, device=device).double().repeat(flights, 1)

    state = {
        "x": repeated(0.5, 0.0, 0.0),
        "v": repeated(0.0, 0.0, 0.0),
        "q": repeated(0.0, 0.0, 0.0, 1.0),
        "w": repeated(0.0, 0.0, 0.0),
        "wind": repeated(0.0, 0.0, 0.0),
        "rotor_speeds": repeated(*4 * [HOVER_RAD_S]),
    }
    wanted = {name: repeated(0.0, 0.0, 0.0) for name in ("x", "x_dot", "x_ddot", "x_dddot", "x_ddddot")}
    wanted |= {"yaw": repeated(0.0)[:, 0], "yaw_dot": repeated(0.0)[:, 0]}
    controller = BatchedSE3Control(parameters, flights, device=device)
    vehicle = BatchedMultirotor(parameters, flights, state, device=device, integrator=integrator)
    every = torch.arange(flights)  # the default, a list, is slower
    with torch.no_grad():
        for k in range(3):
            state = vehicle.step(state, controller.update(k * STEP_S, state, wanted, every), STEP_S, every)
        began, used = time.perf_counter(), time.process_time()
        for k in range(steps):
            state = vehicle.step(state, controller.update(k * STEP_S, state, wanted, every), STEP_S, every)
        times = time.perf_counter() - began, time.process_time() - used
    assert bool(torch.isfinite(state["x"]).all())
    print(json.dumps(times))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3])
