"""The control laws by name: the table that a law reads, and what makes it of a design."""

from protocol.scenario import LAWS, Control

LAWS.register("paper", Control)
LAWS.register("sustained", Control)
