"""Those who are no services of the loop: who watches, who sends, and who hands out its keys."""

from runtime.health import look_at_line
from runtime.services import (
    CONTROLLER_MANAGEMENT,
    PLANT_MANAGEMENT,
    TAP_ADVERSARY,
    Ends,
    Service,
    register,
)

register(
    Service(
        name="dashboard",
        ends={
            "management": Ends((), (PLANT_MANAGEMENT, CONTROLLER_MANAGEMENT)),
            "adversary": Ends((), (TAP_ADVERSARY,)),
        },
    )
)
register(
    Service(
        name="operator",
        ends={"management": Ends((), (CONTROLLER_MANAGEMENT,))},
        publishes={"management": ("management/command/send", "management/command/seal")},
    )
)
for _side in ("controller", "plant"):
    register(Service(name=f"kme-{_side}", health=look_at_line))
