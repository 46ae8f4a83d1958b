"""What people run beside the services: the dashboard, and the operator's command."""

from tests.compose.composition import PATIENCE_S, Composition, all_healthy
from tests.compose.terminal import Terminal

SERVICES = ("controller", "plant", "tap")


def test_the_dashboard_fills_a_terminal_and_q_leaves_it(direct: Composition) -> None:
    all_healthy(direct, SERVICES)
    command = direct.command("run", "--rm", "--no-deps", "dashboard")
    with Terminal(command, direct.environment) as terminal:
        terminal.read_until(
            "\x1b[?1049h",  # the alternate screen
            "sustained",  # the plant has been heard, over ops
            "nearest-centre",  # and the tap, over intel
        )
        terminal.press("q")
        assert terminal.wait(PATIENCE_S) == 0


def test_an_operator_without_a_controller_is_told_so(direct: Composition) -> None:
    said = direct.compose(
        "run", "--rm", "--no-deps", "operator", "send", "to nobody", "--loop", "another",
        "--timeout", "2", check=False,
    )  # fmt: skip
    assert said.returncode == 1
    assert "no controller of loop 'another' answered within 2 s" in said.stderr
