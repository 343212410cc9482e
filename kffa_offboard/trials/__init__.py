"""What every trial flight needs: child processes, true states and what is measured on them, recordings."""
