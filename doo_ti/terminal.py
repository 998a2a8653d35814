"""Text for terminals: what a name holds is shown, never obeyed.

Names of materials, files and cameras come from others; an escape sequence in one could clear the screen or forge a line.
"""


def visible(text: str) -> str:
    """``text`` with control characters, and those that turn the direction of writing, written as ``\\x1b``; line ends stay."""
    if text.isprintable():
        return text
    return "".join(sign if sign.isprintable() or sign == "\n" else sign.encode("unicode_escape").decode() for sign in text)


def in_line(text: object) -> str:
    """A name or path as part of a line: :func:`visible`, and its line ends written as ``\\n``, lest it forge lines."""
    return visible(str(text)).replace("\n", "\\n")


class VisibleStream:
    """A stream of text that writes what is :func:`visible`, and is the ``stream`` otherwise."""

    def __init__(self, stream):
        self._stream = stream

    def write(self, text: str) -> int:
        self._stream.write(visible(text))
        return len(text)

    def __getattr__(self, name: str):
        return getattr(self._stream, name)
