"""From any URDF or MJCF to the description of a hand, each finding with its confidence."""

from smooth_operator.lab.discovery.discover import discover as discover
from smooth_operator.lab.discovery.findings import Discovery as Discovery
from smooth_operator.lab.discovery.findings import Finding as Finding
from smooth_operator.lab.discovery.findings import FoundCoupling as FoundCoupling
from smooth_operator.lab.discovery.findings import FoundFinger as FoundFinger
from smooth_operator.lab.discovery.findings import Overrules as Overrules
