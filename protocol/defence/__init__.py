"""The defence of a loop: when a test of the controller's that fails becomes an alarm."""
