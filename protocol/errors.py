"""The base of the errors that the library raises for wrong input."""


class WynerError(ValueError):
    """Wrong input; the text has a line for each field, with its value and what was expected."""
