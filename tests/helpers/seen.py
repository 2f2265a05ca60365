"""Evidence for one check at a time, of nothing but what that check looks at."""

from __future__ import annotations
