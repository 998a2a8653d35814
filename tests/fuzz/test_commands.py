"""Short commands over the corpus with one thing changed about a file or a word: they succeed, or refuse in one line."""

import pytest

from tests.fuzz import corpus

QUICK = {"relax", "convert", "plan"}  # commands that the default run tries: their kernels compile in seconds


@pytest.mark.parametrize("count, names", [(30, QUICK), pytest.param(2000, None, marks=pytest.mark.slow)])
def test_commands_refuse_in_one_line(tmp_path_factory, capfd, count, names):
    from tests.fuzz.cases import trials  # Hypothesis takes a second to import

    folder = tmp_path_factory.mktemp("corpus")
    corpus.make(folder, quick=names is not None)
    capfd.readouterr()
    trials(count, names, folder, tmp_path_factory, capfd)
