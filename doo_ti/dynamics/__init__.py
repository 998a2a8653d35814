"""How rods move: inertia, damping, drag and moving grippers, one relaxation a time step (docs/dynamics.md)."""
