# SPDX-License-Identifier: Apache-2.0
"""The paper: mixture of spring-dampers (Eq. 1), PoWER (Eqs. 2-3); other learners. Pure."""
