# SPDX-License-Identifier: Apache-2.0
"""Chapter of the report for each study."""
