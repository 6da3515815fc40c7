"""Parcels on a belt past fixed arrays: motion, cutting of a stream, `geraf2 belt`."""
