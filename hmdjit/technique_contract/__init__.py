"""What a technique is, and what holds it to that.

`base` has the contract, `shapes` checks it by shapes, `check` tries it on a technique,
`stencil` sees how far that reads, `small_motion` says how what it shows moves, and
`display_stages` has what comes behind any.
"""
