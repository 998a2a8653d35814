"""How far a long piece of work has come, on standard error: a bar, how much of how much, the rate and the time left."""

from doo_ti.terminal import visible


def progress(*, lasting: bool = False):
    """A bar as a context, to which work is added: ``bar.add_task("growth", total=320, unit="edges")``.

    lasting  whether what it came to stays to be read, in a file too; else it goes with the work, and is for a terminal only

    A task's rate is so many units a second, unless its field ``rate`` says something else.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task) -> Text:
            speed = task.finished_speed or task.speed
            speed = "" if speed is None else f"{speed:,.{0 if speed >= 10 else 2}f} {task.fields['unit']}/s"
            return Text(task.fields.get("rate", speed))

    class Description(ProgressColumn):
        """A name may hold [markup] and escape sequences, which are shown as they are."""

        def render(self, task) -> Text:
            return Text(visible(task.description))

    console = Console(stderr=True)
    columns = BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[unit]}"), Rate(), TimeRemainingColumn()
    return Progress(Description(), *columns, console=console, transient=not lasting,
                    disable=not (lasting or console.is_terminal))
