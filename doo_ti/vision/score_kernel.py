"""The kernel that scores hypotheses under E_vis: E of rods without twist, and E_proj in every camera (§IV-A)."""

from functools import cache

import taichi as ti

from doo_ti.physics.number import Number
from doo_ti.physics.tuples import cross, dot
from doo_ti.vision.edge_integral import edge_integrals


@cache
def score_kernel(number: Number, block: int, bits: int):
    """The compiled-on-first-use kernel for one kind of number, ``block`` threads in a block, and vertices of ``bits`` bits."""
    edge = edge_integrals(number)
    lanes = number.lanes()
    lane, with_lane, constant, width = lanes.lane, lanes.with_lane, lanes.constant, number.width
    scalar = number.scalar

    @ti.func
    def vertex(vertices: ti.template(), first, v):
        """Vertex v of the pack's hypotheses; the last one fills up."""
        x, y, z = (constant(0.0), constant(0.0), constant(0.0))
        for slot in ti.static(range(width)):
            rod = ti.min(first + slot, vertices.shape[0] - 1)
            x = with_lane(x, slot, vertices[rod, v, 0])
            y = with_lane(y, slot, vertices[rod, v, 1])
            z = with_lane(z, slot, vertices[rod, v, 2])
        return x, y, z

    @ti.func
    def rod_energy(vertices: ti.template(), first, alpha, mu, up):
        """Σ α |κb|²/l̄ + μ Σ z l̄ (§III-C), κb = 2 e × e'/(|e| |e'| + e·e')."""
        energy = constant(0.0)
        a0, a1, a2 = vertex(vertices, first, 0)
        d0, d1, d2, before = (constant(0.0), constant(0.0), constant(0.0), constant(0.0))
        for v in range(1, vertices.shape[1]):
            b = vertex(vertices, first, v)
            d = (b[0] - a0, b[1] - a1, b[2] - a2)
            length = ti.sqrt(dot(d, d))
            energy = energy + mu * length * (dot(up, (a0, a1, a2)) + dot(up, b))
            if v > 1:
                normal = cross((d0, d1, d2), d)
                bottom = before * length + dot((d0, d1, d2), d)
                energy = energy + 4.0 * alpha * dot(normal, normal) / (bottom * bottom * (before + length))
            a0, a1, a2 = b
            d0, d1, d2 = d
            before = length
        return energy

    @ti.func
    def camera_error(vertices: ti.template(), first, sets, numbers: ti.template(), values: ti.template(), c):
        """(E_proj of camera c, share unseen)."""
        lens = edge.lens(numbers, c)
        frame = edge.window(numbers, sets, c)
        total, unseen = (constant(0.0), constant(0.0))
        a0, a1, a2 = edge.entered(numbers, c, vertex(vertices, first, 0))
        for v in range(1, vertices.shape[1]):
            b = edge.entered(numbers, c, vertex(vertices, first, v))
            error, hidden = edge.error(
                values, numbers, sets, c, frame, lens, (a0, a1, a2), (b[0] - a0, b[1] - a1, b[2] - a2))
            total = total + error
            unseen = unseen + hidden
            a0, a1, a2 = b
        return total, unseen / ti.cast(vertices.shape[1] - 1, scalar)

    @ti.kernel
    def scored(
        vertices: ti.types.ndarray(dtype=ti.f32 if bits == 32 else ti.f64, ndim=3),  # [hypothesis, vertex, 3] mm
        set_index: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [hypothesis]
        material_index: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [hypothesis]
        stiffness: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [material, (α, μ)]
        up0: ti.f32,
        up1: ti.f32,
        up2: ti.f32,
        numbers: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [set, camera, COLUMNS or more]
        values: ti.types.ndarray(dtype=ti.f32, ndim=1),  # distances, px
        result: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [hypothesis, (energy, errors, shares unseen)] out
    ):
        ti.loop_config(block_dim=block)
        for pack in range((vertices.shape[0] + width - 1) // width):
            first = pack * width
            cameras = numbers.shape[1]
            sets, alpha, mu = (constant(0.0), constant(0.0), constant(0.0))
            for slot in ti.static(range(width)):
                rod = ti.min(first + slot, vertices.shape[0] - 1)
                sets = with_lane(sets, slot, set_index[rod])
                alpha = with_lane(alpha, slot, stiffness[material_index[rod], 0])
                mu = with_lane(mu, slot, stiffness[material_index[rod], 1])
            energy = rod_energy(vertices, first, alpha, mu, (up0, up1, up2))
            for slot in range(width):
                result[ti.min(first + slot, vertices.shape[0] - 1), 0] = lane(energy, slot)
            for c in range(cameras):
                error, unseen = camera_error(vertices, first, sets, numbers, values, c)
                for slot in range(width):
                    rod = ti.min(first + slot, vertices.shape[0] - 1)
                    result[rod, 1 + c] = lane(error, slot)
                    result[rod, 1 + cameras + c] = lane(unseen, slot)

    return scored
