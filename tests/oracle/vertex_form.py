"""E(Γ) as §III-C writes it: vertices, material frames, Bishop frames and twist angles."""

import numpy as np

from tests.oracle.algebra import add, angle, cross, dot, normalise, real, scale, sqrt, transport


def curvature_binormal(edge_before, edge_after):
    """(κb)_i = 2 e^{i−1} × e^i / (|e^{i−1}||e^i| + e^{i−1}·e^i)."""
    lengths = sqrt(dot(edge_before, edge_before) * dot(edge_after, edge_after))
    return scale(2.0 / (lengths + dot(edge_before, edge_after)), cross(edge_before, edge_after))


def twist_angles(tangents, m1):
    """θ^j of each edge against Bishop frames u^j = P_j(u^{j−1}) that start at u^0 = m1^0: a list of E numbers."""
    bishop, angles = m1[0], []
    for j, tangent in enumerate(tangents):
        if j:
            bishop = transport(tangents[j - 1], tangent, bishop)
        angles.append(angle(dot(m1[j], cross(tangent, bishop)), dot(m1[j], bishop)))
    return angles


def vertex_energy(vertices, m1, m2, rest_length, bend, twist, weight, rest_curvature, up):
    """Bend, twist and gravity of one rod, mm·weight: three numbers whose sum is E(Γ).

    vertices (V, 3), m1 and m2 (E, 3): sequences of floats, complex or hyper-dual numbers; rest_length (E,);
    bend (E, 2, 2); twist (E−1,); weight a number; rest_curvature (E−1, 2).
    l̄_i = l_{i−1} + l_i inside, l̄_0 = l_0, l̄_E = l_{E−1}; gravity is measured from the plane up·x = 0.
    """
    count = len(rest_length)
    edges = [add(vertices[j + 1], scale(-1.0, vertices[j])) for j in range(count)]
    angles = twist_angles([normalise(edge) for edge in edges], m1)
    bending = twisting = gravity = 0.0
    for i in range(1, count):
        length = rest_length[i - 1] + rest_length[i]
        binormal = curvature_binormal(edges[i - 1], edges[i])
        for j in (i - 1, i):
            omega = [dot(binormal, m2[j]), -dot(binormal, m1[j])]
            omega = [omega[k] - rest_curvature[i - 1][k] * length / 2.0 for k in range(2)]
            form = sum(bend[j][a][b] * omega[a] * omega[b] for a in range(2) for b in range(2))
            bending = bending + form / (2 * length)
        turn = angles[i] - angles[i - 1]
        turn = turn - 2.0 * np.pi * np.ceil((real(turn) - np.pi) / (2.0 * np.pi))  # to (−π, π]: known modulo a turn only
        twisting = twisting + twist[i - 1] * turn * turn / length
    for i in range(count + 1):
        length = (rest_length[i - 1] if i > 0 else 0.0) + (rest_length[i] if i < count else 0.0)
        gravity = gravity + weight * length * dot(vertices[i], up)
    return bending, twisting, gravity
