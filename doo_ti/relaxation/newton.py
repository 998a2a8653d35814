"""Newton's method on the chain of frames: its options and the numbers of its policy (§III-D, docs/chain.md)."""

from dataclasses import dataclass

from doo_ti.errors import InputError, require_number, require_whole


@dataclass(frozen=True)
class Newton:
    """Options of the Newton solver.

    tolerance       residual to reach: moment times length over stiffness, without a unit; None: TOLERANCES
    max_iterations  factorisations allowed per rod
    first_shift     shift δ of the first factorisation over the largest diagonal entry of H. Zero follows the path of
                    descent more closely and takes more iterations (``careful``).
    max_rotation    largest turn of any edge in one step, rad
    max_escapes     how often a rod may leave a saddle it has converged to
    """

    tolerance: float | None = None
    max_iterations: int = 300
    first_shift: float = 0.05
    max_rotation: float = 0.6
    max_escapes: int = 3

    def __post_init__(self):
        for name in ("first_shift", "max_rotation", *(() if self.tolerance is None else ("tolerance",))):
            require_number("Newton", name, getattr(self, name))
        if self.tolerance is not None and not self.tolerance > 0:
            raise InputError("Newton", "tolerance", f"{self.tolerance} is not positive", "give a positive number")
        for name, least in (("max_iterations", 1), ("max_escapes", 0)):
            require_whole("Newton", name, getattr(self, name), least)
        if not 0 < self.max_rotation <= 1:
            raise InputError("Newton", "max_rotation", f"{self.max_rotation}", "give radians above 0, at most 1")
        if not 0 <= self.first_shift < float("inf"):
            raise InputError("Newton", "first_shift", f"{self.first_shift}", "give a finite number from zero up")

    @classmethod
    def careful(cls, **options) -> "Newton":
        """The policy that keeps closest to descent: use it where basins matter (ribbons)."""
        return cls(first_shift=0.0, **options)


TOLERANCES = {32: 9.9e-5, 64: 9.9e-8}
"""What counts as converged, by bits: of a rod of 99 mm a moment over stiffness of 1e-6 and 1e-9 1/mm."""
SHAPE_TOLERANCE_32 = 1e-4
"""rad: in f32 the next Newton step has to be smaller too, or f64 takes over."""

# The policy's fixed numbers (shifts are over the largest diagonal entry of H).
SHIFT_WRONG_INERTIA = 0.01
SHIFT_REJECTED = 1e-5
DECAY, NEGLIGIBLE = 1 / 16, 1e-5  # after a step that was taken the shift falls by DECAY, below NEGLIGIBLE to zero;
DECAY_TROUBLED, NEGLIGIBLE_TROUBLED = 1 / 4, 1e-6  # more slowly once a step was refused or the inertia wrong
CLOSING_DISTANCE = 0.1  # edge lengths: above it a step only projects
ESCAPE_ROTATION = 0.1  # rad
ESCAPE_ROUNDS = 3.0  # inverse iterations before the first leap off a saddle
COARSE_ROTATION = 0.2  # rad: while steps are larger, an external energy gives its coarse curvature, if it has one
PATIENCE = 25  # trips without progress
PATIENCE_32 = 16  # the same in f32, after which f64 takes over
NOTABLE = 1e-8  # of the energy's magnitude, which locked-in twist may dominate
PATIENCE_AT_SADDLE = 8  # trips without noteworthy progress where the inertia is wrong

# Columns of what a launch is given besides its tables: the unit vector up, the options of Newton, and above how many edge
# lengths from closure a step only closes.
UP, TOLERANCE, ITERATION_LIMIT, FIRST_SHIFT, ROTATION_LIMIT, ESCAPES, CLOSING, POLICY_COLUMNS = 0, 3, 4, 5, 6, 7, 8, 9
