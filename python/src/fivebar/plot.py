"""A figure that shows itself: in a notebook as the value of a cell, elsewhere in a window."""

import io

from matplotlib.figure import Figure


class Plot(Figure):
    """A figure that pyplot does not keep, so that nothing has to be closed."""

    def _repr_png_(self) -> bytes:
        """The picture that a notebook shows."""
        picture = io.BytesIO()
        self.savefig(picture, format="png")
        return picture.getvalue()

    def show(self, warn: bool = True) -> None:
        """Shows the figure now: in a window, which a script waits for, or below the cell of a notebook."""
        import matplotlib.pyplot as plt

        plt.figure(self)
        plt.show()
