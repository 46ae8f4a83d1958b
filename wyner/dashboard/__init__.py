"""Watches the loop and the taps over their buses, on a live screen or in plain lines."""
