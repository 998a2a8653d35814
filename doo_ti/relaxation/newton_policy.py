"""The numbers that the Newton loop goes by (docs/chain.md)."""

INERTIA_OF_A_MINIMUM = 3.0
"""Negative pivots of H and positive eigenvalues of closure's Schur complement, together: one for each row of closure."""
SHAPE_TOLERANCE_32 = 1e-4  # rad: in f32 the next Newton step has to be smaller too, or f64 takes over

# The policy's fixed numbers (shifts are over the largest diagonal entry of H).
SHIFT_WRONG_INERTIA = 0.01
SUFFICIENT = 1 / 3  # of the last shift under which the inertia was right, where it is wrong again (Wächter and Biegler, 2006)
SHIFT_REJECTED = 1e-5  # the least one after a refused step
GROWTH = 4.0  # by how much it grows after a refused step (in contact by SHIFT_GROWTH), and where the inertia is wrong
BETTER, ALIKE = 0.7, 3.0  # times the smallest residual so far: less is progress; less is to and fro across a kink
MOST_SHIFT = 1e3  # times what is stiff at an edge: no shift is larger there
DECAY, NEGLIGIBLE = 1 / 16, 1e-5  # each accepted step multiplies the shift by DECAY, below NEGLIGIBLE it is zero;
DECAY_TROUBLED, NEGLIGIBLE_TROUBLED = 1 / 4, 1e-6  # the same once a step was refused or the inertia was wrong
CUT = 0.1  # a step of which a smaller share may be taken does not make the shift smaller
ROUNDED_STEP, BY_ROUNDING = 1e-10, 1e3  # rad: a smaller step is rounding; how much more than tolerated the residual then may be
FAR_FROM_REST = 1e-3  # residual, above which frames spin before they tilt
# Eigenvalues that are smaller, over H's largest diagonal entry and the rod's evenness, are neutral motions. Contact needs the
# larger number, and so do all rods once they are at rest; before, what is added to the diagonal makes steps less exact.
TRACE, LARGE_TRACE = 1e-12, 1e-9
# The Newton decrement of a rod at rest, in f64: |ωᵀHω| ≤ ((TURN_LEFT tol)² + NEUTRAL ω²) B/L + DECREMENT_ROUNDING |E|, ω the
# size of the step, B the least bending stiffness along the rod and |E| the sum of the energy's absolute terms.
TURN_LEFT, NEUTRAL, DECREMENT_ROUNDING = 300.0, 1e-5, 1e-18
CLOSING_DISTANCE = 0.3  # edge lengths: above it a step only projects
ESCAPE_ROTATION = 0.1  # rad
ESCAPE_ROUNDS = 3.0  # inverse iterations before the first step off a saddle
COARSE_ROTATION = 0.2  # rad: while steps are larger, an external energy gives its coarse curvature, if it has one
PATIENCE = 25  # trips without progress
PATIENCE_32 = 16  # the same in f32, after which f64 takes over
NOTABLE = 1e-8  # of the energy's magnitude, which locked-in twist may dominate
PATIENCE_AT_KINK = 10  # trips without progress, after which steps of rods that touch each other get shorter
PATIENCE_AT_SADDLE = 8  # trips without noteworthy progress where the inertia is wrong
MOST_STRAYS = 24.0  # how often a rod leaves a saddle because of that; without a limit it could go on doing so

# Columns of what a launch is given besides its tables: the unit vector up, the options of Newton, and above how many edge
# lengths from closure a step only closes.
UP, TOLERANCE, ITERATION_LIMIT, FIRST_SHIFT, ROTATION_LIMIT, ESCAPES, CLOSING, POLICY_COLUMNS = 0, 3, 4, 5, 6, 7, 8, 9
