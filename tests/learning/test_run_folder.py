"""A run's folder: of sweeps that start together one gets it; what differs from what a sweep wrote is refused in one line."""

import json
import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Barrier

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from doo_ti import Descent, DistanceGrid, InputError, InterruptedRunError, Surroundings, read_landscape, sweep
from doo_ti.commands.cli import main
from doo_ti.contact.obstacles import Plane, Ring, Sphere
from doo_ti.learning import run_folder
from doo_ti.learning.chunks import maker
from doo_ti.learning.experiment import Experiment, SweepOptions
from doo_ti.learning.run_folder import claim, identity_of, read_plan
from tests.commands.calls import refused, succeeded
from tests.conftest import check_refused
from tests.learning.lab import DYNAMIC, GRID, small_lab


@pytest.fixture(scope="module")
def experiment():
    return Experiment(small_lab(), GRID)


def claimed_at_once(run, experiment, identities: list[str]) -> int:
    together = Barrier(len(identities))

    def begin(identity: str) -> bool:
        together.wait()
        try:
            claim(run, identity, experiment)
        except InputError:
            return False
        return True
    with ThreadPoolExecutor(len(identities)) as threads:
        return sum(threads.map(begin, identities))


def test_of_different_sweeps_one_gets_a_folder_and_of_equal_ones_all(tmp_path, experiment):
    for attempt in range(8):
        assert claimed_at_once(tmp_path / f"different{attempt}", experiment, list("abcd")) == 1
        assert claimed_at_once(tmp_path / f"equal{attempt}", experiment, ["a"] * 4) == 4


def test_a_claim_on_a_full_disk_can_be_made_again(tmp_path, experiment, monkeypatch):
    def full(*arguments, **options):
        raise OSError(28, "No space left on device")
    with monkeypatch.context() as disk:
        disk.setattr(run_folder, "write_whole", full)
        with pytest.raises(InterruptedRunError, match="No space left"):
            sweep(tmp_path / "run", small_lab(), GRID)
    claim(tmp_path / "run", "mine", experiment)


def test_a_folder_that_holds_something_else_is_left_alone(tmp_path, experiment):
    for place in ("notes.txt", "cells/notes.txt"):
        run = tmp_path / place.replace("/", "_")
        (run / place).parent.mkdir(parents=True)
        (run / place).write_text("mine")
        check_refused("something else", claim, run, "mine", experiment)


def test_what_was_killed_holds_nothing_and_what_it_left_half_written_goes(tmp_path, experiment):
    left = [tmp_path / "cells" / ".identity.txt.0123.part", tmp_path / ".run.rrd.ab.part",
            tmp_path / "cells" / ".000000000-000000012.parquet.77.part"]
    left[0].parent.mkdir()
    left[0].write_bytes(b"half")
    claim(tmp_path, "mine", experiment)
    for path in left[1:]:
        path.write_bytes(b"half")
    claim(tmp_path, "mine", experiment)
    assert not any(path.exists() for path in left)
    check_refused("another sweep", claim, tmp_path, "other", experiment)


@pytest.fixture
def copy(finished_sweeps, tmp_path):
    return lambda name: shutil.copytree(finished_sweeps[name][0], tmp_path / name)


def with_value(run, name: str, value) -> None:
    """In the third row of a run's first file of cells."""
    path = min((run / "cells").glob("*.parquet"))
    table = pyarrow.parquet.read_table(path)
    values = table.column(name).to_pylist()
    values[2] = value
    kind = table.schema.field(name).type
    pyarrow.parquet.write_table(table.set_column(table.column_names.index(name), name, pyarrow.array(values, kind)), path)


def flipped(path, place: int, bit: int) -> None:
    content = bytearray(path.read_bytes())
    content[place % len(content)] ^= 1 << bit
    path.write_bytes(content)


@pytest.mark.thorough
@pytest.mark.parametrize(("run", "column", "value"), [
    ("static", "distance_mm", -1.0), ("static", "distance_mm", np.inf), ("static", "distance_mm", None),
    ("static", "status", 77), ("static", "stable", None), ("static", "observation", -1), ("static", "bend_1", None),
    ("dynamic", "pair_weight", -1.0), ("dynamic", "pair_weight", np.nan), ("dynamic", "jumps", -1)])
def test_values_that_no_sweep_finds(capsys, copy, run, column, value):
    folder = copy(run)
    with_value(folder, column, value)
    refused(capsys, folder, ["learn", str(folder)], column)
    check_refused(": ", read_landscape, folder)


@pytest.mark.parametrize(("option", "value"), [
    ("frame_weight_mm", [1.0]), ("frame_weight_mm", -1), ("sub_step_rad", 1e-300), ("sub_step_rad", None), ("spins", -1),
    ("precision", "f16"), ("objective", ["static"]), ("solver", 3), ("clamp_start", 5)])
def test_options_that_no_sweep_has(capsys, copy, option, value):
    folder = copy("static")
    summary = json.loads((folder / "summary.json").read_text())
    summary["provenance"]["options"][option] = value
    (folder / "summary.json").write_text(json.dumps(summary))
    refused(capsys, folder, ["refine", str(folder)], "summary.json")


@pytest.mark.thorough
def test_flipped_bits_of_cells_change_no_result(capsys, copy, rng):
    """The checksums of their pages detect those in values; others are in what nothing is computed from."""
    folder = copy("dynamic")
    expected, path = succeeded(capsys, f"learn {folder}"), min((folder / "cells").glob("*.parquet"))
    whole = path.read_bytes()
    for place, bit in zip(rng.integers(len(whole), size=40), rng.integers(8, size=40), strict=True):
        flipped(path, place, bit)
        code, (out, err) = main(["learn", str(folder)]), capsys.readouterr()
        assert out == expected if code == 0 else code == 2 and not out and err.count("\n") == 1 and path.name in err
        path.write_bytes(whole)


def torn(path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


def pipe(path) -> None:
    path.unlink()
    os.mkfifo(path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="takes pipes with names")
@pytest.mark.sampled(3)
@pytest.mark.parametrize(("damage", "name"), [
    (torn, "observations.npz"), (lambda path: flipped(path, 700, 1), "cells/plan.json"), (pipe, "pairs.csv"),
    (pipe, "observations.npz"), (pipe, "cells/plan.json"), (Path.unlink, "landscape.png")])
def test_what_is_lost_or_damaged_is_made_again(copy, damage, name):
    run = copy("dynamic")
    whole, best = (run / name).read_bytes(), read_landscape(run).best
    damage(run / name)
    assert read_landscape(run).best == best
    assert sweep(run, small_lab(), GRID, options=DYNAMIC)["timing"]["relaxed_rods"] in (0, 48), "the cells are kept"
    assert (run / name).read_bytes() == whole


def test_what_was_observed_is_not_taken_from_a_torn_file(capsys, copy):
    folder = copy("dynamic")
    torn(folder / "observations.npz")
    refused(capsys, folder, ["figures", str(folder), "--out", str(folder / "figures")], "observations.npz")


@pytest.mark.thorough
@pytest.mark.parametrize("damage", [None, b"{", b"[]", b"null", b"{}", b"\xff\xfe", b"[" * 100_000])
def test_a_summary_is_made_again_from_the_cells(copy, damage):
    path = copy("static") / "summary.json"
    best = json.loads(path.read_text())["best"]
    path.unlink() if damage is None else path.write_bytes(damage)
    (path.parent / "run.rrd").unlink()
    summary = sweep(path.parent, small_lab(), GRID)
    assert summary["best"] == best and summary["timing"]["relaxed_rods"] == 0 and (path.parent / "run.rrd").is_file()
    assert sweep(path.parent, small_lab(), GRID) == json.loads(json.dumps(summary))
    min((path.parent / "cells").glob("*.parquet")).unlink()
    assert sweep(path.parent, small_lab(), GRID)["best"] == best


def test_a_flipped_bit_in_an_unfinished_run_is_named(copy):
    folder = copy("static")
    (folder / "summary.json").unlink()
    chunk = min((folder / "cells").glob("*.parquet"))
    column = pyarrow.parquet.ParquetFile(chunk).metadata.row_group(0).column(9)
    assert column.path_in_schema == "energy", "which nothing but the recording needs"
    begin = column.data_page_offset if column.dictionary_page_offset is None else column.dictionary_page_offset
    flipped(chunk, begin + column.total_compressed_size - 20, 6)
    check_refused(chunk.name, sweep, folder, small_lab(), GRID)


@pytest.mark.thorough
def test_cells_and_summaries_of_another_run_are_not_taken(capsys, copy, tmp_path):
    folder = copy("static")
    sweep(tmp_path / "other", replace(small_lab(), vertices=small_lab().vertices + 1.0), GRID)
    chunk = min((folder / "cells").glob("*.parquet"))
    shutil.copy(min((tmp_path / "other" / "cells").glob("*.parquet")), chunk)
    refused(capsys, folder, ["learn", str(folder)], chunk.name, "belongs to another sweep")
    (folder / "summary.json").unlink()
    check_refused("sweep", sweep, folder, small_lab(), GRID)
    shutil.rmtree(folder)
    folder = copy("static")
    shutil.copy(tmp_path / "other" / "summary.json", folder)
    refused(capsys, folder, ["learn", str(folder)], chunk.name)


def test_another_version_does_not_resume_a_run(copy, monkeypatch):
    folder = copy("static")
    monkeypatch.setattr(run_folder, "maker", lambda: maker() | {"doo_ti": "99.0"})
    check_refused(f"{maker()['doo_ti']}.*99.0", sweep, folder, small_lab(), GRID)


def test_an_identity_that_is_none_is_refused(copy):
    path = copy("static") / "cells" / "identity.txt"
    path.write_bytes(b"\xff\xfe\x00")
    check_refused("another sweep", sweep, path.parents[1], small_lab(), GRID)
    path.unlink()
    path.symlink_to("/dev/zero")
    check_refused("a device", sweep, path.parents[1], small_lab(), GRID)


def among(*obstacles, radius=2.0, **options) -> Experiment:
    surroundings = Surroundings(obstacles, radius) if obstacles else Surroundings()
    return Experiment(small_lab(), GRID, SweepOptions(surroundings=surroundings, **options))


def test_the_identity_of_a_sweep_depends_on_its_obstacles():
    table, low = Plane((0, 0, -900), (0, 0, 1)), Plane((0, 0, -901), (0, 0, 1))
    found = [identity_of(one) for one in (among(), among(table), among(low), among(table, low), among(table, radius=1.5))]
    assert len(set(found)) == 5 and identity_of(among(Plane((0, 0, -900), (0, 0, 1)))) == found[1]


def test_obstacles_of_all_kinds_are_read_back_from_the_folder_of_a_run(tmp_path):
    values = np.full((4, 4, 4), 9.0)
    values[1:3, 1:3, 1:3] = -1.0
    around = [Plane((0, 0, -900), (0, 0, 1), 0.3), Sphere((0, 0, -900), 5), Ring((0, 900, 0), (0, 0, 1), 9, 1),
              DistanceGrid(values, 5.0, (0, 0, -900))]
    one = among(*around)
    claim(tmp_path / "run", identity_of(one), one)
    again, identity = read_plan(tmp_path / "run")
    assert identity == identity_of(one) and again.options.as_dict()["obstacles"] == one.options.as_dict()["obstacles"]
    assert list(map(type, again.options.surroundings.obstacles)) == list(map(type, around))
    for damage in ("obstacles.npz", "cells/plan.json"):
        path = tmp_path / "run" / damage
        path.write_bytes(path.read_bytes().replace(b"plane", b"space") if damage.endswith("json") else b"PK")
        check_refused(": ", read_plan, tmp_path / "run")


def test_rods_inside_obstacles_and_what_a_sweep_cannot_use_are_refused():
    far = Plane((0, 0, -900), (0, 0, 1))
    check_refused(r"obstacles: the clamp of rod \d is .* mm inside a Plane", among, Plane((0, 0, 900), (0, 0, 1)))
    middle = small_lab().vertices[:, 16]
    check_refused(r"obstacles: the centreline of rod . is [\d.]+ mm inside a Sphere", among, Sphere(middle[0], 3.0))
    check_refused("solver: Descent", among, far, solver=Descent())
    check_refused("obstacles: .* for each rod", among, far, radius=np.linspace(1.0, 2.0, 6))
