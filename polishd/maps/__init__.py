"""`polishd map`: show, compare, convert, average and stitch interferometer maps, test absolutely, commission."""
