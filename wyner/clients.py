"""Those who are no services of the loop: who watches, who sends, and who hands out its keys."""

from runtime.health import look_at_line
from runtime.services import CONTROLLER_OPS, PLANT_OPS, TAP_INTEL, Ends, Service, register

register(
    Service(
        name="dashboard",
        ends={
            "ops": Ends((), (PLANT_OPS, CONTROLLER_OPS)),
            "intel": Ends((), (TAP_INTEL,)),
        },
    )
)
register(
    Service(
        name="operator",
        ends={"ops": Ends((), (CONTROLLER_OPS,))},
        publishes={"ops": ("ops/command/send", "ops/command/seal")},
    )
)
for _side in ("controller", "plant"):
    register(Service(name=f"kme-{_side}", health=look_at_line))
