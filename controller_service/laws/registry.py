"""The control laws by name: the table that a law reads, and what makes it of a design."""

from controller_service.laws.tables import PackedControl
from protocol.scenario import LAWS, Control

LAWS.register("paper", Control)
LAWS.register("sustained", Control)
LAWS.register("packed", PackedControl)
