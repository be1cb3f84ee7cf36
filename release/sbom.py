"""The software bill of materials of a wheel: what the package is and what it needs, as CycloneDX 1.6 in JSON.

It lists what pip is asked for, with the versions that are allowed. What pip chooses depends on the day and the machine.
"""

from __future__ import annotations

import uuid
from datetime import datetime, timezone
from email import message_from_string
from typing import Mapping

from cyclonedx.model import ExternalReference, ExternalReferenceType, Property, XsUri
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentScope, ComponentType
from cyclonedx.model.license import DisjunctiveLicense, LicenseAcknowledgement
from cyclonedx.output.json import JsonV1Dot6
from packageurl import PackageURL
from packaging.requirements import Requirement

_REFERENCES = {"website": "website", "bugtracker": "issue-tracker", "repository": "vcs"}
"""CycloneDX's name for each type of an address in package.xml."""


def sbom_json(metadata: str, urls: Mapping[str, str], time_s: int) -> str:
    """Returns the SBOM of a package.

    Args:
        metadata: the file METADATA of its wheel.
        urls: addresses of the project, by their types in package.xml.
        time_s: when it was made, in s since 1970.
    """
    fields = message_from_string(metadata)
    name, version = fields["Name"], fields["Version"]
    licence = DisjunctiveLicense(id="Apache-2.0", acknowledgement=LicenseAcknowledgement.DECLARED)
    package = Component(
        name=name,
        version=version,
        type=ComponentType.APPLICATION,
        bom_ref=f"{name}@{version}",
        purl=PackageURL("pypi", None, name.lower().replace("_", "-"), version),
        description=fields["Summary"],
        licenses=[licence],
        external_references=[
            ExternalReference(type=ExternalReferenceType(_REFERENCES[kind]), url=XsUri(url))
            for kind, url in urls.items()
        ],
    )
    bom = Bom(serial_number=uuid.uuid5(uuid.NAMESPACE_URL, f"pypi/{name}/{version}/{time_s}"))
    bom.metadata.timestamp = datetime.fromtimestamp(time_s, timezone.utc)
    bom.metadata.component = package
    requirements = map(Requirement, fields.get_all("Requires-Dist", []))
    # The same library may be required and, with further features, be optional: the first one counts.
    needed = {each.name: _component(each) for each in reversed([*requirements])}
    bom.components.update(needed.values())
    bom.register_dependency(package, needed.values())
    return JsonV1Dot6(bom).output_as_string(indent=1)


def _component(requirement: Requirement) -> Component:
    marker = str(requirement.marker or "")
    properties = {"versions": str(requirement.specifier) or "any", "marker": marker}
    return Component(
        name=requirement.name,
        type=ComponentType.LIBRARY,
        bom_ref=requirement.name,
        scope=ComponentScope.OPTIONAL if "extra" in marker else ComponentScope.REQUIRED,
        purl=PackageURL("pypi", None, requirement.name.lower()),
        properties=[Property(name=f"robot_health_monitor:{key}", value=each) for key, each in properties.items()],
    )
