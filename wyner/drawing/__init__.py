"""Figures that commands and the library draw, in one style, the same bytes twice."""
