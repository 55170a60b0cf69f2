"""Code behind a notebook's cell that has `picture` in its metadata: it stores the cell's figure as an SVG, which README shows."""

import json


def saving(file: str) -> str:
    """Lines of Python; the same figure gives the same bytes."""
    return (
        "\nfrom matplotlib import pyplot\n"
        'with pyplot.rc_context({"svg.hashsalt": "fivebar"}):\n'
        f'    pyplot.savefig({json.dumps(file)}, metadata={{"Date": None}}, bbox_inches="tight")\n'
    )
