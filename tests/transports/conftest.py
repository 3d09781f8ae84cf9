"""The conformance kit asserts, so pytest shall explain its assertions too."""

import pytest

pytest.register_assert_rewrite("tests.transports.conformance")
