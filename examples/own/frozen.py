"""The sensor repeats its last honest reading for ever."""

from attacker_service.base import SensorAttack


class Frozen(SensorAttack):
    name = "frozen"

    def sensor(self, observed):
        return observed.shown
