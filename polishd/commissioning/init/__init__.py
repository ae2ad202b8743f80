"""`polishd init`: questions, answers and the files of a new cell."""
