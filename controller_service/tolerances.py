"""Every tolerance of the control side, once, with its reason."""

ROUNDINGS = 8
"""Each T_i of one or two states is shrunk by this many half-ulps of what its facets' products add
up: with four, rounding in the loop left the next set in 66 of 4 million adversarial steps, with
eight in none."""

LEAST_DEFLATION = 2e-13
"""Each T_i of one or two states and one input is shrunk by at least this fraction."""

SOLVED_DEFLATION = 1e-6
"""Each T_i of three or four states, or of two inputs, is shrunk by at least this fraction: Qhull
may drop a thinner facet, and a solver's answer may miss a constraint by its tolerance."""

LARGEST_SPREAD = 1e6
"""Sets of three or four states end where a facet adds up products this much larger than its bound.
Qhull then drops facets that matter: beside an exact recursion of plants with three states the first
set that held a state which no input steers had 4e7."""

CONDITION = 1e8
"""With a larger condition number, in the best units of the states, A counts as singular: the state
bounds limit the sets."""

GROWTH = 1e-8
"""The recursion ends when no facet of T_i moves by more than this fraction of its distance."""

LARGEST_OFFSET = 1e150
"""A set larger than this is refused: squares of its offsets would overflow."""

TERMINAL_MARGIN = 1e-4
"""T_0 is made invariant for a D_c this fraction larger: u = K x then has room for rounding."""

SLOW_MARGINS = (1e-3, 1e-2)
"""The same where K brings the state back so slowly that less leaves no room."""

THIN = 1e-9
"""Where D_c reaches a facet of T_0 by less than this fraction, D_c is too thin, not K too slow."""

TERMINAL_ERROR = 1e-3
"""Without a stated order, T_0 takes the first whose error bound is this part of its radius."""

NEARLY_PARALLEL = 1e-11
"""Normals of the terminal set nearer than this, in rad, are one: their bounds round by more."""

CHAIN_PARALLEL = 1e-12
"""A facet whose unit normal meets B's direction by less than this fraction bounds no input."""

SOLVER_MARGIN = 1e-9
"""Two-input programs see U smaller by this fraction, so a solver's rounding stays inside U."""

SOLVER_TOLERANCE = 1e-11
"""Primal tolerance asked of the solvers, of a target's offsets and of U's size; well under every
margin, well over rounding."""
