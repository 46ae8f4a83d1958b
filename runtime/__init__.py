"""What a process runs on: buses, journals, traces, signals."""
