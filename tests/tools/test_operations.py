"""Operations counted in LLVM's code, by loop."""

import pytest

from doo_ti.bench.cases import OPERATIONS
from tools.bench.operations import TOLERANCE, counted


@pytest.mark.slow
@pytest.mark.parametrize("kind", OPERATIONS)
def test_the_package_counts_what_the_kernels_execute(kind):
    assert counted(kind) == pytest.approx(OPERATIONS[kind], rel=TOLERANCE)
