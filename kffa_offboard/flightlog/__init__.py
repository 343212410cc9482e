"""Recording and reading flights: telemetry logs (.tlog) and the controller's inner signals in them."""
