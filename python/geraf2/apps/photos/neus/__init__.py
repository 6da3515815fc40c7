"""Volume rendering of photos: coloured signed distances, background, samples along rays."""
