"""Other people's flights: reading .tlog, .BIN and .ulg, estimators in shadow, identification and tuning."""
