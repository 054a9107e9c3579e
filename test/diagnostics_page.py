"""What docs/diagnostics.md says that the nodes tell."""

from pathlib import Path
import re

PAGE = Path(__file__).parents[1] / 'docs' / 'diagnostics.md'


def told(part):
    """Return the figures of a part, `driver: board` for example, in alphabetical order."""
    sections = re.split(r'\n(?=[^|\n].*:\n)', PAGE.read_text())
    (section,) = (text for text in sections if f'`{part}`' in text.splitlines()[0])
    rows = re.findall(r'^\| (`.*?) \|', section, re.MULTILINE)
    return sorted(name for row in rows for name in re.findall('`(.*?)`', row))
