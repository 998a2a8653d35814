"""Errors a user can cause, each a sentence that names what is wrong, where, and the remedy.

Numerical trouble is not an error: it is a per-rod :class:`~doo_ti.types.Status`.
"""


class InputError(ValueError):
    """Wrong input. The command line prints it as one line and exits with code 2.

    Parameters
    ----------
    source: the file, option or argument at fault.
    field: the key, column or option in it.
    problem: what is wrong with the value, with the value.
    remedy: what to do about it.
    """

    def __init__(self, source: str, field: str, problem: str, remedy: str):
        self.source, self.field, self.problem, self.remedy = str(source), str(field), problem, remedy
        super().__init__(" ".join(f"{source}: {field}: {problem}; {remedy}".split()))


class InterruptedRunError(RuntimeError):
    """A long run stopped on the way; what was finished is kept and the message says how to go on (exit code 1)."""


def system_reason(error: Exception) -> str:
    """What the system says of a file that cannot be read or written, in lower case, for an InputError's problem."""
    return (getattr(error, "strerror", None) or str(error)).lower()
