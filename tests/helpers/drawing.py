"""Pictures that are drawn coarsely: tests ask what is drawn, not how finely."""

from geraf2.report import canvas, figures


def small_pictures(patch, dpi=40):
    patch.setattr(canvas, "_DPI", dpi)
    patch.setattr(figures, "_MESH_PIXELS", 40)
