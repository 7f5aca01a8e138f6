"""The older name of what MKS drives obey."""

from conformance.drives.drive import Request

Order = Request
