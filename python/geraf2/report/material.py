"""What a run found the content to be made of."""

from collections.abc import Mapping
from html import escape

from geraf2.io.run_folder import StageRecord
from geraf2.surfaces.transparency import describe


def material_note(stages: Mapping[str, StageRecord]) -> list[str]:
    """One sentence where back faces were seen through the content, else nothing."""
    text = describe(stages["glints"].numbers) if "glints" in stages else ""
    return [f'<p class="note">{escape(text[0].upper() + text[1:])}.</p>'] if text else []
