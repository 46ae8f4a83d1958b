"""Watches the loop over ops and the taps over intel, on a live screen or in plain lines."""
