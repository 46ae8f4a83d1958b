"""Exactly once over a faulty network: both ends of the link, sans I/O."""
