"""A fit from noisy readings: N stated, W certified, and what the scheme makes of it."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from protocol.scenario import Scenario
from tests.fit.test_fit import CART, DYNAMICS
from wyner.cli.main import main
from wyner.fit.fitting import fit
from wyner.fit.identification import identify
from wyner.fit.plan import Plan
from wyner.fit.sessions import residuals_under
from wyner.fit.toml import as_toml

NOISE = (0.0006, 0.004)
"""Half-widths of the sensors' noise, of D_c's order in the cart's position."""

NOISY: dict[str, Any] = {
    **CART,
    "plant": {**CART["plant"], "noise": {"half_widths": list(NOISE)}},
    "defender": {"noise": {"half_widths": list(NOISE)}},
    "secrecy": {"alpha": 12.0, "candidates": 2},
}
PLAN = Plan(sessions=40, excite_steps=200, steps=60, seed=2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("noisy-cart")
    (path / "cart.py").write_text(DYNAMICS)
    (path / "cart.toml").write_text(as_toml(NOISY, "A cart with air drag, read through noise."))
    return path


@pytest.fixture(scope="module")
def cart(folder: Path) -> Scenario:
    return fit(NOISY, folder / "cart.toml", PLAN, 0.05)[1]


def test_noise_is_told_from_disturbance() -> None:
    """A linear plant, 40,000 readings: A by instruments."""
    rng = np.random.default_rng(3)
    A, B = np.array([[0.95, 0.1], [0.0, 0.8]]), np.array([[0.05], [0.5]])
    steps, sessions, deviation = 400, 100, np.array([0.02, 0.05])
    x = np.zeros((sessions, 2))
    read = [x + rng.normal(0, deviation, x.shape)]
    applied = []
    for _ in range(steps):
        u = rng.uniform(-1, 1, (sessions, 1))
        x = x @ A.T + u @ B.T + rng.uniform(-0.02, 0.02, x.shape)
        read.append(x + rng.normal(0, deviation, x.shape))
        applied.append(u)
    y = np.array(read).transpose(1, 0, 2)
    inputs = np.array(applied).transpose(1, 0, 2)
    before, at, after = y[:, :-2], y[:, 1:-1], y[:, 2:]
    u_at = inputs[:, 1:]
    plain, better = identify(at, u_at, after), identify(at, u_at, after, before)
    assert abs(better.A - A).max() < 0.01
    assert abs(better.A - A).max() < 0.5 * abs(plain.A - A).max()


def test_the_certificate_is_of_w_and_holds_on_sessions_that_nobody_fitted(
    cart: Scenario, folder: Path
) -> None:
    s = cart
    assert s.defender.calibration is not None
    W = s.test_set.half_widths
    D_c = s.defender.disturbance.half_widths
    assert W is not None
    assert D_c is not None
    assert (np.array(W) > np.array(D_c)).all()
    residuals = residuals_under(s, folder, replace(PLAN, seed=77), range(5000, 5040))
    left = (np.abs(residuals) > np.array(W) * (1 + 1e-9)).any(axis=(1, 2)).sum()
    assert left / 40 <= s.defender.calibration.violation + 0.1


def test_the_command_says_what_the_promise_rests_on(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "fitted.toml"
    few = ["--sessions", "20", "--steps", "40"]
    command = ["fit", str(folder / "cart.toml"), "-o", str(out), *few]
    assert main([*command, "--excite-steps", "200"]) == 0
    said = capsys.readouterr().out.replace("\n  ", " ")
    assert "leaves W = D_c + N - A N with probability" in said
    assert "D_c itself rests on N, which is stated" in said
    assert "[defender.noise]" in out.read_text()
    (folder / "cart.py").rename(tmp_path / "cart.py")
    try:
        assert main(["design", str(out), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["noisy"] is True
    finally:
        (tmp_path / "cart.py").rename(folder / "cart.py")
