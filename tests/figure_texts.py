"""Texts of a figure, and which of them lie on each other."""

from matplotlib.backends.backend_agg import FigureCanvasAgg


def texts(figure):
    """All texts of a figure that are in view."""
    for axes in figure.axes:
        yield from (
            axes.xaxis.label,
            axes.yaxis.label,
            axes._left_title,
            axes._right_title,
            *axes.texts,
        )
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            yield from (t.label1 for t in axis.get_major_ticks() if low <= t.get_loc() <= high)
    yield from figure.texts
    for legend in (*figure.legends, *filter(None, (axes.get_legend() for axes in figure.axes))):
        yield from legend.get_texts()


def overlaps(figure):
    """Pairs of texts of which one lies on the other."""
    FigureCanvasAgg(figure).draw()
    shown = [text for text in texts(figure) if text.get_text() and text.get_visible()]
    boxes = [(text.get_text(), text.get_window_extent()) for text in shown]
    return [
        (name, other)
        for i, (name, box) in enumerate(boxes)
        for other, another in boxes[:i]
        if box.width > 0 and another.width > 0 and box.overlaps(another)
    ]
