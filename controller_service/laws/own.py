"""A law in a file of the user's, asked once before anything runs under it."""

import numpy as np

from controller_service.laws.base import CandidateLaw
from controller_service.laws.online import OutsideError, ProgramError
from protocol.link.session import rules_of
from protocol.scenario import Scenario


def refuse_odd_answers(name: str, law: CandidateLaw, scenario: Scenario) -> None:
    """Ask a user's law at the origin, for one state and for many.

    Parameters
    ----------
    name : str
        As ``control.law`` gives it, for the message.
    law : CandidateLaw
    scenario : Scenario

    Raises
    ------
    ProgramError
        With one line, when it raises what no law may, or its candidates are not M of m inputs in
        U, or differ between the two.
    """
    B = np.array(scenario.B)
    shape = (scenario.secrecy.candidates, B.shape[1])
    x = (0.0,) * B.shape[0]
    try:
        one = np.array(law.candidates(x), dtype=float)
        many = np.array(law.candidates_many([x]), dtype=float)
    except (OutsideError, ProgramError):
        return  # the law's own word, told to whoever asks at a state of the loop
    except Exception as error:  # the code is the user's
        why = " ".join(str(error).split())
        raise ProgramError(f"control.law: {name}: {type(error).__name__}: {why}") from error
    if one.shape != shape:
        raise ProgramError(
            f"control.law: {name}: candidates for one state: got shape {one.shape}, expected "
            f"{shape}, M candidates of m inputs"
        )
    if not all(map(rules_of(scenario).admissible, one.tolist())):
        raise ProgramError(
            f"control.law: {name}: candidates: got {one.tolist()}, expected each in control.inputs"
        )
    if many.shape != (1, *shape):
        raise ProgramError(
            f"control.law: {name}: candidates for many states: got shape {many.shape} for one, "
            f"expected {(1, *shape)}"
        )
    if not np.array_equal(one, many[0]):
        raise ProgramError(
            f"control.law: {name}: candidates: got {one.tolist()} for one state and "
            f"{many[0].tolist()} for many, expected the same"
        )
