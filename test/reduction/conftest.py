"""Commands within this process, as in the tests of studies."""

from test.study.conftest import call, cantilever, command, stamp, stop  # noqa: F401
