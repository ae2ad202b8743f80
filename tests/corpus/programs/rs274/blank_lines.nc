G21 G90 G94
G0 X0 Y0 Z0

   
	
G1 X10 F600

(nothing)
;
G4 P0.5

M2
