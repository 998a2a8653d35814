"""F, the relaxation operator of §III-D: Newton on the chain of frames, and the paper's descent."""
