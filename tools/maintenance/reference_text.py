"""For the reference pages: docstrings keep their columns of names and meanings, which Markdown would run together.

An extension of Griffe, which mkdocstrings uses: the first paragraph of a docstring stays text, all after it is shown as it is.
"""

import re

import griffe

ROLE = re.compile(r":(?:class|func|meth|mod|data|attr):`~?([^`]+)`")  # of Sphinx; its text is enough


class ReferenceText(griffe.Extension):
    def on_instance(self, *, obj, **kwargs) -> None:
        if obj.is_alias or obj.docstring is None:
            return
        first, gap, rest = ROLE.sub(r"`\1`", obj.docstring.value).partition("\n\n")
        first = first.replace("``", "`")
        obj.docstring.value = f"{first}\n\n```text\n{rest}\n```" if gap else first
