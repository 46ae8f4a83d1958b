"""The attacker: spoofs the sensor, the actuator or the field bus with what Eve holds."""
