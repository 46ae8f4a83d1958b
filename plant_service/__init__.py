"""The plant: its simulation, its coin, and the receiving end of the link."""
