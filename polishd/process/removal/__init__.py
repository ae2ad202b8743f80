"""Material removal: contact, tool influence functions, convolution and effect of a dwell map."""
