"""The rod's mathematics as Taichi functions on values.

A quantity is "a number per rod": a scalar, or a pack of lanes that holds the same quantity of many rods. The functions
here are written once for both (see :mod:`doo_ti.physics.number`). Vectors are 3-tuples, quaternions 4-tuples, symmetric
3×3 matrices the 6-tuple (11, 12, 13, 22, 23, 33) and full ones the 9-tuple by rows. Packs have no unary minus: ``0.0 - x``.
"""
