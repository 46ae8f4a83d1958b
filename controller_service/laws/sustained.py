"""The law ``sustained``: both programs of (27) go on being solved inside T_0."""

from controller_service.laws.base import ProgramLaw


class SustainedLaw(ProgramLaw):
    """Programs at every index, with T_0 ~ D_c as the target inside T_0."""
