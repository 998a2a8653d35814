"""A recording, read back."""

from collections import defaultdict


def read(path) -> tuple[dict, dict]:
    """{entity: {column: rows}} of the static data, and {entity: {timeline: {column: rows}}} of the rest, as lists
    in the order of the timeline."""
    from rerun.chunk import RrdReader

    static, moving = defaultdict(dict), defaultdict(lambda: defaultdict(lambda: defaultdict(list)))
    for chunk in RrdReader(path).stream():
        columns = chunk.to_record_batch().to_pydict()
        if chunk.is_static:
            static[chunk.entity_path].update(columns)
        for timeline in () if chunk.is_static else chunk.timeline_names:
            for name, rows in columns.items():
                moving[chunk.entity_path][timeline][name] += rows
    for timelines in moving.values():
        for timeline, columns in timelines.items():
            order = sorted(range(len(columns[timeline])), key=columns[timeline].__getitem__)
            timelines[timeline] = {name: [rows[k] for k in order] for name, rows in columns.items()}
    return static, moving
