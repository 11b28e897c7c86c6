"""Store of the results of long computations in a folder, reused while they are valid.

The package is independent of hands: a result has a key, which is any JSON, and the digest of the
code that computed it.
"""

from smooth_operator.result_cache.cache import Job as Job
from smooth_operator.result_cache.cache import JobResult as JobResult
from smooth_operator.result_cache.cache import Note as Note
from smooth_operator.result_cache.cache import ResultCache as ResultCache
from smooth_operator.result_cache.cache import ResultLog as ResultLog
from smooth_operator.result_cache.cache import compute_results as compute_results
from smooth_operator.result_cache.cache import content_name as content_name
from smooth_operator.result_cache.cache import find_results as find_results
from smooth_operator.result_cache.cache import key_digest as key_digest
from smooth_operator.result_cache.cache import longest_first as longest_first
from smooth_operator.result_cache.cache import no_note as no_note
from smooth_operator.source_digest import code_digest as code_digest
