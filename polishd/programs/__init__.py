"""`polishd program` and `polishd plan`: make, rewrite, verify and plan a part program without a cell."""
