"""The look of all tables of results."""

from rich import box
from rich.table import Table
from rich.text import Text


def plain_table(title: str) -> Table:
    """Return a table without a frame, with its title and caption at the left."""
    return Table(
        box=box.SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        padding=(0, 1, 0, 0),
        title=Text(title, style="bold"),
        title_justify="left",
        caption_justify="left",
        caption_style="",
    )
