"""What the numbers of the scanner mean: actions, roles of words, columns and slots of its state."""

from __future__ import annotations

# What a G code does.
NEUTRAL, RAPID, LINE_TO, ARC_CW, ARC_CCW, CANCEL, DWELL = 1, 2, 3, 4, 5, 6, 7
PLANE_XY, PLANE_ZX, PLANE_YZ, INCH, MM, INCH_LENGTHS = 8, 9, 10, 11, 12, 13
ABSOLUTE, INCREMENTAL, INVERSE, PER_MINUTE, OFFSET = 14, 15, 16, 17, 18
MACHINE, HOME, PATH, VECTORS_ON, VECTORS_OFF = 19, 20, 21, 22, 23
# G codes of one group exclude each other in a block. Indexed by what they do.
GROUP = (0, 0, 1, 1, 1, 1, 10, 2, 3, 3, 3, 4, 4, 4, 5, 5, 6, 6, 7, 2, 2, 8, 9, 9)
M_NEUTRAL, M_ENDS, M_STOPS = 1, 2, 3

# What a word is.
(
    R_UNKNOWN, R_N, R_G, R_M, R_F, R_AXIS, R_NEUTRAL, R_ARC, R_P, R_TIME, R_PROGRAM, R_KEYWORD, R_STATEMENT, R_CALL,
) = range(14)  # fmt: skip
WORDS = 64
BARE, NAMES = 26, 27
"""Code of a number without a letter, and of the first name; letters are 0 to 25."""
L_F, L_N, L_R = 5, 13, 17

# Units of a dwell's number.
U_NONE, U_S, U_MS, U_REFUSE = 0, 1, 2, 3

# A dialect's flags.
(
    PARENS, SEMICOLON, EOB, BLANKS, ASSIGN, DELETE, WHOLE, TAPE_NAME, NUMBERED, OWN_BLOCK, LONGEST, G93, FEED_UNSURE,
    FLAGS,
) = range(14)  # fmt: skip
DELETE_REFUSE, DELETE_RUN, DELETE_SKIP = 0, 1, 2
WHOLE_MM, WHOLE_UM, WHOLE_UNSURE = 0, 1, 2
G93_REFUSE, G93_PER_MINUTE, G93_SECONDS = 0, 1, 2

# State between lines: ``at``.
(
    LINE, MOTION, FEED_MODE, DISTANCE, UNIT, PLANE, WCS, F_LINE, F_STYLE, DWELLS_FOR, DWELLED, MOVES, DWELL_COUNT,
    OPENED, ENDED, VECTORING, NAMED, FED, PROGRAM, UNSURE, UNSURE_FEED, COLUMN, CODE, NEXT, N_MOVES, N_DWELLS, N_MODES,
    GROUPS, LETTERS, TAIL, GAPPED, PADDED, LOWER, AT_SIZE,
) = range(34)  # fmt: skip
SAID_INVERSE, SAID_PER_MINUTE = 1, 2
SAID_ABSOLUTE, SAID_INCREMENTAL = 1, 2
# Which slot an action sets, and to what; -1: what it does is more than that. Indexed by action.
SLOT = (
    -1, -1, MOTION, MOTION, MOTION, MOTION, -1, -1, PLANE, PLANE, PLANE, -1, -1, -1, DISTANCE, DISTANCE, -1, -1, -1,
    -1, -1, -1, VECTORING, VECTORING,
)  # fmt: skip
VALUE_OF = (
    0, 0, RAPID, LINE_TO, ARC_CW, ARC_CCW, 0, 0, PLANE_XY, PLANE_ZX, PLANE_YZ, 0, 0, 0, SAID_ABSOLUTE, SAID_INCREMENTAL,
    0, 0, 0, 0, 0, 0, 1, 0,
)  # fmt: skip
# ``now``: x y z mm, a b c deg, i j k; then F as written, and mm per unit of lengths and of feeds.
AXES, FEED, UNIT_MM, FEED_UNIT_MM, VALUE, NOW_SIZE = 9, 9, 10, 11, 12, 13

# Columns of what is found.
M_LINE, M_KIND, M_START, M_END, M_STYLE, M_TAIL, M_F_LINE, M_LOWER, MOVE_INTS = range(8 + 1)
V_FEED, V_UNIT, MOVE_FLOATS = 9, 10, 11
D_LINE, D_START, D_END, D_STYLE, D_MOVE, D_OTHERS, DWELL_INTS = range(7)
D_SECONDS, D_SCALE, DWELL_FLOATS = 0, 1, 2
E_START, E_END, E_CODE, MODE_INTS = 0, 1, 2, 3
K_ARC, K_INVERSE = 4, 8
"""Kind of a move: 2 rapid, 3 line, 4 and 5 arcs, and 8 more where F is the time."""

# Which kinds of words a block has.
HAS_AXIS, HAS_TIME, HAS_P, HAS_ARC = 1, 2, 4, 8

# A number's style: decimals, then flags (KEEP: with and without a point it means something else), and the width of its
# whole part where that is padded with zeros.
MOST_DECIMALS, S_POINT, S_PLUS, S_BARE, S_KEEP, S_WIDTH = 15, 16, 32, 64, 128, 256

W_CODE, W_START, W_END, W_STYLE, W_INTS, MOST_WORDS = 0, 1, 2, 3, 4, 48
X_WORD, I_WORD = 23, 8
"""Letters of the first axis and the first arc offset; the others follow."""
ARC_TOLERANCE_MM = 0.02
POW10 = tuple(10.0**digits for digits in range(19))
LARGEST = 1e9
FAR = 1e4
"""mm or degrees; no position without a decimal point is so far off."""
TEN = tuple(10**digits for digits in range(19))
