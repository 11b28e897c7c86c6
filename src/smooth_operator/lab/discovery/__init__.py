"""From any URDF or MJCF to the description of a hand, each finding with its confidence."""

from smooth_operator.lab.discovery.discover import discover as discover
from smooth_operator.lab.discovery.landmarks import Discovery as Discovery
from smooth_operator.lab.discovery.landmarks import Finding as Finding
from smooth_operator.lab.discovery.landmarks import FoundCoupling as FoundCoupling
from smooth_operator.lab.discovery.landmarks import FoundFinger as FoundFinger
from smooth_operator.lab.discovery.landmarks import Overrules as Overrules
