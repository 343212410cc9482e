"""What a user can see on the own machine before flying: law, flights, faults, guard, replay, timing, log."""
