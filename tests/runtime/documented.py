"""The tables of docs/formats.md, so that document and code cannot part."""

import re
from pathlib import Path


def schema_texts() -> dict[str, str]:
    """Name of each message -> its definition as the document has it."""
    text = (Path(__file__).parents[2] / "docs" / "formats.md").read_text()
    texts = {}
    for name, block in re.findall(r"schema `(palmar_msgs/msg/\w+)`[^\n]*\n+((?:    [^\n]*\n)+)", text):
        texts[name] = re.sub(r"^    ", "", block, flags=re.MULTILINE)
    for name, line in re.findall(
        r"schema `(palmar_msgs/msg/(?:DeviceBytes|Timing))`[^:]*: (`float64 time_s`[^.:]*)[.:]", text
    ):
        texts[name] = "\n".join(re.findall(r"`([^`]+)`", line)) + "\n"
    return texts
