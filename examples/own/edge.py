"""An alarm where a reading comes near the edge of D_c."""

from studies.attacks.defences import Defence


class Edge(Defence):
    name = "edge"

    def alarm(self, session, step, gauges):
        return gauges.min(-1) > 0.84
