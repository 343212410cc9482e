"""`python -m sim_vehicle` is `sim-vehicle`."""

from sim_vehicle.cli import main

main()
