"""The power parts of converters that are elements of the network."""
