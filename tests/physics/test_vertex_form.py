"""The paper's vertex form against complex steps: bend forces and twist where frames follow their edges (§III-D)."""

import numpy as np
import taichi as ti
from scipy.spatial.transform import Rotation

from doo_ti import runtime
from doo_ti.physics import vertex_form
from tests.oracle.algebra import cross, dot, normalise, transport
from tests.oracle.vertex_form import curvature_binormal, material_curvature, twist_angles

STEP = 1e-100
table = ti.types.ndarray(dtype=ti.f64, ndim=2)


@ti.func
def triple(source: ti.template(), row, at: ti.template()):
    return (source[row, at], source[row, at + 1], source[row, at + 2])


@ti.kernel
def fill(edges: table, frames: table, stiffness: table, out: table):
    """Rows of (bend energy, its slope in the edge before, in the edge after)."""
    for row in range(edges.shape[0]):
        before, after = triple(edges, row, 0), triple(edges, row, 3)
        m1_left, m2_left = triple(frames, row, 0), triple(frames, row, 3)
        m1_right, m2_right = triple(frames, row, 6), triple(frames, row, 9)
        b_left, b_right, rest = triple(stiffness, row, 0), triple(stiffness, row, 3), triple(stiffness, row, 6)
        inverse = stiffness[row, 9]
        kb, bottom = vertex_form.curvature_binormal(before, after, stiffness[row, 10], stiffness[row, 11])
        left = vertex_form.material_curvature(kb, m1_left, m2_left)
        right = vertex_form.material_curvature(kb, m1_right, m2_right)
        moment_left = vertex_form.bend_moment(b_left, left, rest, inverse)
        moment_right = vertex_form.bend_moment(b_right, right, rest, inverse)
        out[row, 0] = vertex_form.bend_energy(moment_left, left, rest)
        out[row, 0] += vertex_form.bend_energy(moment_right, right, rest)
        of_before, of_after = vertex_form.bend_force(
            moment_left, moment_right, m1_left, m2_left, m1_right, m2_right, kb, bottom, before, after)
        for k in ti.static(range(3)):
            out[row, 1 + k] = of_before[k]
            out[row, 4 + k] = of_after[k]


def bend_and_twist(edges, frames, bend, rest, total):
    """Bend energy and twist of one vertex by definition, after both edges moved and their frames followed them."""
    tangents = [normalise(list(edge)) for edge in edges]
    m1 = [transport(list(frame[:, 0]), t, list(frame[:, 1])) for frame, t in zip(frames, tangents, strict=True)]
    binormal, energy = curvature_binormal(*edges), 0.0
    for t, first, b in zip(tangents, m1, bend, strict=True):
        omega = material_curvature(binormal, first, cross(t, first))
        strain = [omega[k] - rest[k] for k in range(2)]
        energy = energy + sum(b[j, k] * strain[j] * strain[k] for j in range(2) for k in range(2)) / (2 * total)
    angles = twist_angles(tangents, m1)
    return energy, angles[1] - angles[0]


def test_forces_and_twist_where_frames_follow_their_edges(rng):
    """Along an edge the forms differ, lengths being held; across it every slope is the definition's."""
    runtime.start()
    count = 20
    first, joint = Rotation.random(count, random_state=rng), Rotation.from_rotvec(rng.normal(size=(count, 3)) * 0.5)
    frames = np.stack([first.as_matrix(), (first * joint).as_matrix()], axis=1)
    lengths = rng.uniform(2, 4, (count, 2))
    edges = lengths[..., None] * frames[..., 0]
    root = rng.normal(size=(count, 2, 2, 2)) * 300
    bend = root @ np.swapaxes(root, -1, -2) + 1e4 * np.eye(2)
    rest, total = 0.1 * rng.normal(size=(count, 2)), lengths.sum(axis=1)
    entries = [bend[:, side, a, b] for side in (0, 1) for a, b in ((0, 0), (1, 1), (0, 1))]
    stiffness = np.column_stack([*entries, rest, 0 * total, 1 / total, lengths])
    directors = np.concatenate([frames[:, 0, :, 1], frames[:, 0, :, 2], frames[:, 1, :, 1], frames[:, 1, :, 2]], axis=1)
    out = np.zeros((count, 7))
    fill(edges.reshape(count, 6), directors, stiffness, out)
    for row in range(count):
        energy, _ = bend_and_twist(edges[row], frames[row], bend[row], rest[row], total[row])
        np.testing.assert_allclose(out[row, 0], energy, rtol=1e-12)
        binormal = np.array(curvature_binormal(*edges[row]))
        for side in (0, 1):
            slope = out[row, 1 + 3 * side : 4 + 3 * side]
            for across in frames[row, side, :, 1:].T:
                moved = edges[row].astype(complex)
                moved[side] += 1j * STEP * across
                energy, twist = bend_and_twist(moved, frames[row], bend[row], rest[row], total[row])
                np.testing.assert_allclose(slope @ across, energy.imag / STEP, atol=1e-12 * np.abs(slope).max())
                holonomy = 0.5 * dot(binormal, across) / lengths[row, side]
                np.testing.assert_allclose(twist.imag / STEP, holonomy, atol=1e-13)
