"""A figure that can show itself: in a notebook as the value of a cell, elsewhere in a window."""

import io

from matplotlib.figure import Figure


class Plot(Figure):
    """A figure without a reference in pyplot, so it need not be closed."""

    def _repr_png_(self) -> bytes:
        """The picture for a notebook."""
        picture = io.BytesIO()
        self.savefig(picture, format="png")
        return picture.getvalue()

    def show(self, warn: bool = True) -> None:
        """Shows the figure: below the cell of a notebook, or in a window; a script waits until the window is closed."""
        import matplotlib.pyplot as plt

        plt.figure(self)
        plt.show()
