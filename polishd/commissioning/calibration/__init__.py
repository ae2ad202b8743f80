"""`polishd calibrate`: fits of robot, tool and instrument from measurements."""
