"""Defences: what both ends do to a step under keys that they share, a file each."""
