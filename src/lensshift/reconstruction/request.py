"""Where the phasor channel looks for `Request`; see `lensshift.reconstruction.method`."""

from lensshift.reconstruction.method import Request as Request
