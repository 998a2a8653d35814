"""What a finished sweep says of itself: summary.json."""

import json
from pathlib import Path

from doo_ti.errors import InputError, system_reason


def read_summary(run: Path) -> dict:
    """The summary of a finished sweep. Raises InputError where the folder holds none that can be read."""
    path = Path(run) / "summary.json"
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(path, "file", system_reason(error), "name the folder of a finished sweep") from None
    except (ValueError, RecursionError) as error:
        raise InputError(path, "file", f"not JSON ({error})", "run the sweep again") from None
    if not isinstance(summary, dict):
        raise InputError(path, "file", "holds no table", "run the sweep again")
    return summary
