"""One importer per calibration format; `assemblyhands_core.data.rigs.read_calibration` chooses among them."""


class UnknownFormatError(ValueError):
    """The document is of another format than this importer's, or broken beyond recognition."""
