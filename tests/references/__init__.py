"""Closed forms and continuum solutions that F must meet, one file per row of the list of references.

The continuum rod has α = EI, β = GJ and weight per length 2μ; a clamped edge clamps at its midpoint, so a chain
of E edges stands for a rod that is shorter by half of each clamped edge.
"""
