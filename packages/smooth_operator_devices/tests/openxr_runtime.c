/* An OpenXR runtime with two hands and no headset, for tests; it is steered by the functions at the
 * end. Written from the OpenXR specification 1.0 (structures, result codes, session life cycle,
 * actions, XR_EXT_hand_tracking, XR_HTCX_vive_tracker_interaction, XR_MND_headless, XR_KHR_convert_timespec_time) and its loader's interface:
 * https://registry.khronos.org/OpenXR/specs/1.1/html/xrspec.html and .../loader.html
 * and, for the tensors that feedback pushes, from XR_NVX1_push_tensor.h and XR_NVX1_tensor_data.h in
 * deps/cloudxr/openxr_extensions of https://github.com/NVIDIA/IsaacTeleop (Apache-2.0)
 */
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <time.h>

typedef int32_t XrResult;
typedef uint64_t Handle;
typedef struct { int32_t type; void *next; } Header;

enum { SUCCESS = 0, EVENT_UNAVAILABLE = 4, SESSION_NOT_FOCUSED = 8, VALIDATION = -1, FUNCTION_UNSUPPORTED = -7,
       FEATURE_UNSUPPORTED = -8, EXTENSION_NOT_PRESENT = -9, SIZE_INSUFFICIENT = -11,
       HANDLE_INVALID = -12, SESSION_RUNNING = -14, SYSTEM_INVALID = -18, SESSION_NOT_READY = -28,
       SESSION_NOT_STOPPING = -29, PATH_UNSUPPORTED = -22,
       TIME_INVALID = -30, ACTIONSET_NOT_ATTACHED = -46, FORM_FACTOR_UNAVAILABLE = -35,
       GRAPHICS_DEVICE_INVALID = -38 };
enum { IDLE = 1, READY = 2, SYNCHRONIZED = 3, VISIBLE = 4, FOCUSED = 5, STOPPING = 6 };
enum { INSTANCE = 11, SYSTEM = 22, SESSION = 33, SPACE = 44, TRACKER = 50 /* + hand */,
       ACTION_SET = 66, ACTION = 77, ACTION_SPACE = 100 /* + path */,
       TENSORS = 200 };
enum { JOINTS = 26 };

typedef struct { uint64_t flags; float orientation[4], position[3]; float radius; } Joint;

static const char *EXTENSIONS[] = {
    "XR_EXT_hand_tracking", "XR_MND_headless", "XR_KHR_convert_timespec_time",
    "XR_MNDX_xdev_space", "XR_EXTX_overlay", "XR_NVX1_tensor_data", "XR_NVX1_opaque_data_channel",
    "XR_HTCX_vive_tracker_interaction", "XR_NVX1_push_tensor"};
enum { KNOWN = sizeof EXTENSIONS / sizeof *EXTENSIONS };
static int offered = 7, stage = 1, headset = 1, can_track = 1, ready_at_once = 0;
static int enabled, state, running, instances;
static int queue[64], first, last;
static int active[3];
static Joint hands[3][JOINTS];
static int64_t asked;
static char paths[16][256]; /* a path is its place, from 1 */
static int known, attached, synced, located_flags[16];
static float placed[16][7];
static char collection[256];
static uint32_t sample_size, pushed;
static uint8_t samples[64][256];

static void push(int next) { state = next; queue[last++ % 64] = next; }

static XrResult enumerate_extensions(const char *layer, uint32_t capacity, uint32_t *count,
                                     struct { int32_t type; void *next; char name[128];
                                              uint32_t version; } *out) {
    uint32_t found = 0;
    for (int k = 0; k < KNOWN; k++) {
        if (!(offered >> k & 1)) continue;
        if (capacity) {
            if (found >= capacity) return SIZE_INSUFFICIENT;
            strcpy(out[found].name, EXTENSIONS[k]);
            out[found].version = 1;
        }
        found++;
    }
    *count = found;
    return SUCCESS;
}

static XrResult create_instance(
    const struct { int32_t type; const void *next; uint64_t flags;
                   char application[264 + 8]; /* XrApplicationInfo: 128 + 4 + 128 + 4 + 8 */
                   uint32_t layers; const char *const *layer_names;
                   uint32_t count; const char *const *names; } *info, Handle *out) {
    if (info->application[0] == 0) return VALIDATION;
    enabled = 0;
    for (uint32_t n = 0; n < info->count; n++) {
        int known = 0;
        for (int k = 0; k < KNOWN; k++)
            if ((offered >> k & 1) && !strcmp(info->names[n], EXTENSIONS[k])) known = 1 << k;
        if (!known) return EXTENSION_NOT_PRESENT;
        enabled |= known;
    }
    first = last = state = running = known = attached = synced = pushed = 0;
    memset(located_flags, 0, sizeof located_flags);
    instances++;
    *out = INSTANCE;
    return SUCCESS;
}

static XrResult destroy_instance(Handle instance) {
    if (instance != INSTANCE) return HANDLE_INVALID;
    instances--;
    running = 0;
    return SUCCESS;
}

static XrResult instance_properties(Handle instance, struct { int32_t type; void *next;
                                                             uint64_t version; char name[128]; } *out) {
    if (instance != INSTANCE) return HANDLE_INVALID;
    out->version = (uint64_t)1 << 48;
    strcpy(out->name, "of the tests");
    return SUCCESS;
}

static XrResult get_system(Handle instance, const struct { int32_t type; const void *next;
                                                           int32_t form; } *info, uint64_t *out) {
    if (instance != INSTANCE) return HANDLE_INVALID;
    if (info->form != 1 || !headset) return FORM_FACTOR_UNAVAILABLE;
    *out = SYSTEM;
    return SUCCESS;
}

static XrResult create_session(Handle instance, const struct { int32_t type; const void *next;
                               uint64_t flags; uint64_t system; } *info, Handle *out) {
    if (instance != INSTANCE) return HANDLE_INVALID;
    if (info->system != SYSTEM) return SYSTEM_INVALID;
    if (!info->next && !(enabled & 2)) return GRAPHICS_DEVICE_INVALID; /* no graphics binding */
    *out = SESSION;
    push(IDLE);
    if (ready_at_once) push(READY);
    return SUCCESS;
}

static XrResult enumerate_views(Handle instance, uint64_t system, uint32_t capacity,
                                uint32_t *count, int32_t *out) {
    *count = 1;
    if (system != SYSTEM) return SYSTEM_INVALID;
    if (capacity) *out = 2; /* XR_VIEW_CONFIGURATION_TYPE_PRIMARY_STEREO */
    return SUCCESS;
}

static XrResult system_properties(Handle instance, uint64_t system, Header *out) {
    for (Header *one = out->next; one; one = one->next)
        if (one->type == 1000051000) /* XrSystemHandTrackingPropertiesEXT */
            *(uint32_t *)(one + 1) = can_track;
    return system == SYSTEM ? SUCCESS : SYSTEM_INVALID;
}

static XrResult destroy(Handle any) { return SUCCESS; }

static XrResult locate_space(Handle space, Handle base, int64_t time,
                             struct { int32_t type; void *next; uint64_t flags; float pose[7]; } *out) {
    if (base != SPACE) return HANDLE_INVALID;
    if (space == SPACE) return SUCCESS; /* nothing is valid in it */
    int path = space - ACTION_SPACE;
    if (path < 1 || path > known) return HANDLE_INVALID;
    if (time <= 0) return TIME_INVALID;
    asked = time;
    out->flags = synced ? located_flags[path] : 0;
    if (out->flags) memcpy(out->pose, placed[path], sizeof out->pose);
    return SUCCESS;
}

static XrResult string_to_path(Handle instance, const char *text, uint64_t *out) {
    if (instance != INSTANCE) return HANDLE_INVALID;
    for (*out = 1; *out <= (uint64_t)known; ++*out)
        if (!strcmp(paths[*out], text)) return SUCCESS;
    strcpy(paths[known = *out], text);
    return SUCCESS;
}

static XrResult create_action_set(Handle instance, const struct { int32_t type; const void *next;
                                  char name[64], shown[128]; uint32_t priority; } *info, Handle *out) {
    if (instance != INSTANCE) return HANDLE_INVALID;
    if (info->type != 28 || !info->name[0] || !info->shown[0]) return VALIDATION;
    *out = ACTION_SET;
    return SUCCESS;
}

static XrResult create_action(Handle set, const struct { int32_t type; const void *next; char name[64];
                              int32_t kind; uint32_t count; const uint64_t *paths;
                              char shown[128]; } *info, Handle *out) {
    if (set != ACTION_SET) return HANDLE_INVALID;
    if (info->type != 29 || info->kind != 4 || !info->count || attached) return VALIDATION;
    for (uint32_t k = 0; k < info->count; k++)
        if (strncmp(paths[info->paths[k]], "/user/vive_tracker_htcx/role/", 29)) return PATH_UNSUPPORTED;
    *out = ACTION;
    return SUCCESS;
}

static XrResult suggest(Handle instance, const struct { int32_t type; const void *next;
                        uint64_t profile; uint32_t count;
                        const struct { Handle action; uint64_t path; } *bindings; } *info) {
    if (instance != INSTANCE) return HANDLE_INVALID;
    if (info->type != 51 || !info->count || attached) return VALIDATION;
    if (strcmp(paths[info->profile], "/interaction_profiles/htc/vive_tracker_htcx")) return PATH_UNSUPPORTED;
    for (uint32_t k = 0; k < info->count; k++) {
        if (info->bindings[k].action != ACTION) return HANDLE_INVALID;
        if (!strstr(paths[info->bindings[k].path], "/input/grip/pose")) return PATH_UNSUPPORTED;
    }
    return SUCCESS;
}

static XrResult attach(Handle session, const struct { int32_t type; const void *next; uint32_t count;
                                                      const Handle *sets; } *info) {
    if (session != SESSION || info->count != 1 || *info->sets != ACTION_SET) return HANDLE_INVALID;
    if (info->type != 60) return VALIDATION;
    attached = 1;
    return SUCCESS;
}

static XrResult sync_actions(Handle session, const struct { int32_t type; const void *next; uint32_t count;
                             const struct { Handle set; uint64_t path; } *sets; } *info) {
    if (session != SESSION || info->count != 1 || info->sets->set != ACTION_SET) return HANDLE_INVALID;
    if (info->type != 61 || info->sets->path) return VALIDATION;
    if (!attached) return ACTIONSET_NOT_ATTACHED;
    synced = state == FOCUSED;
    return synced ? SUCCESS : SESSION_NOT_FOCUSED;
}

static XrResult create_action_space(Handle session, const struct { int32_t type; const void *next;
                                    Handle action; uint64_t path; float pose[7]; } *info, Handle *out) {
    if (session != SESSION || info->action != ACTION) return HANDLE_INVALID;
    if (info->type != 38 || info->pose[3] != 1.0f) return VALIDATION;
    *out = ACTION_SPACE + info->path;
    return SUCCESS;
}

static XrResult begin_session(Handle session, const Header *info) {
    if (session != SESSION) return HANDLE_INVALID;
    if (running) return SESSION_RUNNING;
    if (state != READY) return SESSION_NOT_READY;
    running = 1;
    push(SYNCHRONIZED);
    push(VISIBLE);
    push(FOCUSED);
    return SUCCESS;
}

static XrResult end_session(Handle session) {
    if (session != SESSION) return HANDLE_INVALID;
    if (state != STOPPING) return SESSION_NOT_STOPPING;
    running = 0;
    push(IDLE);
    return SUCCESS;
}

static XrResult poll_event(Handle instance, struct { int32_t type; const void *next; Handle session;
                                                     int32_t state; int64_t time; } *out) {
    if (instance != INSTANCE) return HANDLE_INVALID;
    if (first == last) return EVENT_UNAVAILABLE;
    out->type = 18; /* XR_TYPE_EVENT_DATA_SESSION_STATE_CHANGED */
    out->session = SESSION;
    out->state = queue[first++ % 64];
    out->time = 1;
    return SUCCESS;
}

static XrResult enumerate_spaces(Handle session, uint32_t capacity, uint32_t *count, int32_t *out) {
    int32_t kinds[] = {1, 2, 3}; /* view, local, stage */
    *count = stage ? 3 : 2;
    if (session != SESSION) return HANDLE_INVALID;
    if (capacity && capacity < *count) return SIZE_INSUFFICIENT;
    if (capacity) memcpy(out, kinds, *count * sizeof *out);
    return SUCCESS;
}

static XrResult create_space(Handle session, const struct { int32_t type; const void *next;
                             int32_t kind; float orientation[4], position[3]; } *info, Handle *out) {
    if (session != SESSION) return HANDLE_INVALID;
    if (info->kind != (stage ? 3 : 2) || info->orientation[3] != 1.0f) return VALIDATION;
    *out = SPACE;
    return SUCCESS;
}

static XrResult create_tracker(Handle session, const struct { int32_t type; const void *next;
                               int32_t hand, set; } *info, Handle *out) {
    if (session != SESSION) return HANDLE_INVALID;
    if (info->type != 1000051001 || info->hand < 1 || info->hand > 2 || info->set) return VALIDATION;
    if (!can_track) return FEATURE_UNSUPPORTED;
    *out = TRACKER + info->hand;
    return SUCCESS;
}

static XrResult locate(Handle tracker,
                       const struct { int32_t type; const void *next; Handle space;
                                      int64_t time; } *info,
                       struct { int32_t type; void *next; uint32_t active, count;
                                Joint *joints; } *out) {
    if (tracker != TRACKER + 1 && tracker != TRACKER + 2) return HANDLE_INVALID;
    if (info->type != 1000051002 || info->space != SPACE) return VALIDATION;
    if (out->type != 1000051003 || out->count != JOINTS || !out->joints) return VALIDATION;
    if (info->time <= 0) return TIME_INVALID;
    asked = info->time;
    out->active = running && active[tracker - TRACKER];
    memset(out->joints, 0, JOINTS * sizeof(Joint));
    if (out->active) memcpy(out->joints, hands[tracker - TRACKER], JOINTS * sizeof(Joint));
    return SUCCESS;
}

static XrResult convert_time(Handle instance, const struct timespec *from, int64_t *out) {
    if (instance != INSTANCE) return HANDLE_INVALID;
    *out = from->tv_sec * 1000000000LL + from->tv_nsec;
    return SUCCESS;
}

static XrResult convert_back(Handle instance, int64_t from, struct timespec *out) {
    if (instance != INSTANCE) return HANDLE_INVALID;
    if (from <= 0) return TIME_INVALID;
    out->tv_sec = from / 1000000000LL, out->tv_nsec = from % 1000000000LL;
    return SUCCESS;
}

static XrResult create_tensors(Handle session, const struct { int32_t type; const void *next;
                               const Header *tensors; char identifier[256], shown[256];
                               uint8_t uuid[16]; uint32_t count, size; } *info,
                               void *result, Handle *out) {
    if (session != SESSION) return HANDLE_INVALID;
    if (info->type != 1000850003 || info->count != 1 || info->tensors->type != 1000850002) return VALIDATION;
    if (!info->identifier[0] || !info->size || info->size > sizeof *samples) return VALIDATION;
    strcpy(collection, info->identifier);
    sample_size = info->size;
    *out = TENSORS;
    return SUCCESS;
}

static XrResult push_tensors(Handle tensors, const struct { int32_t type; const void *next;
                             int64_t time; uint64_t device_time; const uint8_t *buffer;
                             uint32_t size; } *data) {
    if (tensors != TENSORS) return HANDLE_INVALID;
    if (data->type != 1000850005 || data->size < sample_size) return VALIDATION;
    memcpy(samples[pushed++ % 64], data->buffer, sample_size);
    return SUCCESS;
}

static XrResult get_proc_addr(Handle instance, const char *name, void **out) {
    static const struct { const char *name; void *function; int needs; } TABLE[] = {
        {"xrGetInstanceProcAddr", get_proc_addr, 0},
        {"xrEnumerateInstanceExtensionProperties", enumerate_extensions, 0},
        {"xrCreateInstance", create_instance, 0},
        {"xrDestroyInstance", destroy_instance, 0},
        {"xrGetInstanceProperties", instance_properties, 0},
        {"xrGetSystem", get_system, 0},
        {"xrCreateSession", create_session, 0},
        {"xrBeginSession", begin_session, 0},
        {"xrEndSession", end_session, 0},
        {"xrPollEvent", poll_event, 0},
        {"xrEnumerateReferenceSpaces", enumerate_spaces, 0},
        {"xrCreateReferenceSpace", create_space, 0},
        {"xrCreateHandTrackerEXT", create_tracker, 1},
        {"xrDestroyHandTrackerEXT", destroy, 1},
        {"xrDestroySession", destroy, 0},
        {"xrDestroySpace", destroy, 0},
        {"xrLocateSpace", locate_space, 0},
        {"xrEnumerateViewConfigurations", enumerate_views, 0},
        {"xrGetSystemProperties", system_properties, 0},
        {"xrStringToPath", string_to_path, 0},
        {"xrCreateActionSet", create_action_set, 0},
        {"xrCreateAction", create_action, 128},
        {"xrSuggestInteractionProfileBindings", suggest, 128},
        {"xrAttachSessionActionSets", attach, 0},
        {"xrSyncActions", sync_actions, 0},
        {"xrCreateActionSpace", create_action_space, 0},
        {"xrLocateHandJointsEXT", locate, 1},
        {"xrCreatePushTensorCollectionNV", create_tensors, 256},
        {"xrPushTensorCollectionDataNV", push_tensors, 256},
        {"xrDestroyPushTensorCollectionNV", destroy, 256},
        {"xrConvertTimespecTimeToTimeKHR", convert_time, 4},
        {"xrConvertTimeToTimespecTimeKHR", convert_back, 4},
    };
    *out = NULL;
    for (size_t k = 0; k < sizeof TABLE / sizeof *TABLE; k++)
        if (!strcmp(name, TABLE[k].name) && (TABLE[k].needs & enabled) == TABLE[k].needs)
            *out = TABLE[k].function;
    return *out ? SUCCESS : FUNCTION_UNSUPPORTED;
}

XrResult xrNegotiateLoaderRuntimeInterface(
    const struct { int32_t type; uint32_t version; size_t size; uint32_t least, most;
                   uint64_t least_api, most_api; } *loader,
    struct { int32_t type; uint32_t version; size_t size; uint32_t interface_version;
             uint64_t api; void *get_proc_addr; } *runtime) {
    runtime->interface_version = 1;
    runtime->api = (uint64_t)1 << 48 | 34; /* 1.0.34 */
    runtime->get_proc_addr = get_proc_addr;
    return SUCCESS;
}

/* for the tests */
void offer(int extensions, int with_stage, int with_headset, int with_tracking) {
    offered = extensions, stage = with_stage, headset = with_headset, can_track = with_tracking;
    active[1] = active[2] = 0;
}
void be_ready_at_once(int yes) { ready_at_once = yes; }
void change_state(int next) { push(next); }
void show_hand(int hand, int visible, const Joint *joints) {
    memcpy(hands[hand], joints, sizeof hands[hand]);
    active[hand] = visible;
}
void show_tracker(const char *role, int flags, const float *pose) {
    for (int k = 1; k <= known; k++)
        if (!strncmp(paths[k], "/user/vive_tracker_htcx/role/", 29) && !strcmp(paths[k] + 29, role)) {
            memcpy(placed[k], pose, sizeof placed[k]);
            located_flags[k] = flags;
        }
}
int pushed_samples(void) { return pushed; }
const uint8_t *pushed_sample(int number) { return samples[number % 64]; }
const char *pushed_to(void) { return collection; }
int open_instances(void) { return instances; }
int is_running(void) { return running; }
int64_t last_time(void) { return asked; }
