"""Maps: conditioning, registration, resampling, Zernike, spectra, statistics, tolerances, uncertainty."""
