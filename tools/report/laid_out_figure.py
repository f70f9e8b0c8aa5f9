"""A figure of matplotlib that is drawn once for each file."""

from typing import Any

from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine


class LaidOutFigure(Figure):
    """Whoever saves a figure draws it twice: at first with all marks left out, so that its layout is
    computed, and then without a layout engine. Of the first drawing only the layout is needed."""

    def draw(self, renderer: Any) -> None:
        """Compute the layout if that is still to be done; else draw."""
        engine = self.get_layout_engine()
        if isinstance(engine, ConstrainedLayoutEngine):
            engine.execute(self)
        else:
            super().draw(renderer)
