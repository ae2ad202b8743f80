G21 G90 G94
G0 X0 Y0 Z0
g 1 x 1 0 f 6 0 0
g 4 p 0 . 7 5
M2
