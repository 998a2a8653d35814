"""Operations counted in LLVM's code, by loop."""

import pytest

from doo_ti.bench.cases import OPERATIONS
from tools.bench.operations import TOLERANCE, counted, in_loops

FUNCTION = """define void @kernel(<16 x float>* %0) {
  %2 = load <16 x float>, <16 x float>* %0
  br label %trip

trip:                                             ; preds = %after, %1
  %3 = fmul <16 x float> %2, %2
  %4 = call <16 x float> @llvm.sqrt.v16f32(<16 x float> %3)
  br label %edge

edge:                                             ; preds = %joint, %trip
  %5 = fadd <16 x float> %4, %3
  %6 = fdiv <16 x float> %5, %3
  %7 = fadd float 1.0, 2.0
  br i1 undef, label %rest, label %joint

rest:                                             ; preds = %edge
  %8 = fsub <16 x float> %6, %5
  br label %joint

joint:                                            ; preds = %rest, %edge
  br i1 undef, label %edge, label %after

after:                                            ; preds = %joint
  br i1 undef, label %trip, label %done

done:                                             ; preds = %after
  %9 = fmul <16 x float> %2, %2
  ret void
}"""


def test_operations_on_packs_belong_to_their_loop():
    assert in_loops(FUNCTION) == (3, 2)


@pytest.mark.slow
@pytest.mark.parametrize("kind", OPERATIONS)
def test_the_package_counts_what_the_kernels_execute(kind):
    assert counted(kind) == pytest.approx(OPERATIONS[kind], rel=TOLERANCE)
