"""Arithmetic on planes that reads neighbouring pixels: what techniques share.

`neighborhood` has the few pixels around each, `edges` finds edges and walks along them,
`line_coverage` says how much of a pixel lies beyond a line, `edge_spans` how far FXAA
moves across, `downsampling` makes one pixel of several, `temporal` reads the past and
says what of it may be shown, `sample_store` keeps samples of it and moves them,
`scattering` says which of several things is where they move to.
"""
