"""Volume rendering of photos: coloured signed distances, samples along rays."""
