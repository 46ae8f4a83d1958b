"""She says for ever what she said last."""

from attacker_service.base import SensorAttack


class Frozen(SensorAttack):
    name = "frozen"

    def sensor(self, observed):
        return observed.shown
