"""Arithmetic on planes that reads neighbouring pixels: what techniques share.

`neighborhood` has the few pixels around each. Of spatial techniques: `edges` finds
edges and walks along them, `line_coverage` says how much of a pixel lies beyond a line,
`edge_spans` how far FXAA moves across, `downsampling` makes one pixel of several. Of
temporal ones: `temporal` reads the past and says what of it may be shown,
`same_surface` whether it is of the same thing, `running_mean` goes on with it,
`aliasing` says where it is needed, `dynamic_regions` where it is not to be had,
`sample_store` keeps samples and moves them, `scattering` says which of several things
is where they move to, `motion_blur` smears.
"""
