"""How fast this machine relaxes rods, and how well."""

import json
from argparse import Namespace

from doo_ti import options as given
from doo_ti.commands.arguments import add_json
from doo_ti.commands.printing import plain
from doo_ti.whole_file import write_whole

MOST_ROUNDS = 1000


def declare(add) -> None:
    parser = add("bench", allow_abbrev=False, help="throughput and accuracy on this machine, one table")
    parser.add_argument("--rods", metavar="N", help="rods in the large batches (default 65536)")
    parser.add_argument("--threads", metavar="N", help="threads of the kernels (default: one per processor)")
    parser.add_argument("--rounds", metavar="N", help="measurements of which the median counts (default 3)")
    parser.add_argument("--scaling", action="store_true", help="also over rods, edges and threads; takes minutes")
    parser.add_argument("--jax", action="store_true", help="also the same solver in JAX, which needs to be installed")
    parser.add_argument("--out", metavar="FOLDER", help="folder for bench.json and pictures (default: none)")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: Namespace, words: list[str]) -> int:
    """Throughput and accuracy on this machine; with a folder also as JSON and pictures."""
    given.jax(options.jax)
    rods, threads = given.bench_rods(options.rods, 65_536), given.threads(options.threads)
    rounds = given.whole("--rounds", options.rounds, 1, MOST_ROUNDS) or 3
    out = None if options.out is None else given.output_folder(options.out)

    from doo_ti.bench import study
    from doo_ti.bench.table import text

    summary = study.measured(study.Plan(rods, rounds, threads, options.scaling, options.jax))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        content = json.dumps(plain(summary), indent=2) + "\n"
        write_whole(out / "bench.json", lambda file: file.write(content.encode()))
        study.draw(out, summary)
    print(json.dumps(plain(summary)) if options.json else text(summary))
    return 0
