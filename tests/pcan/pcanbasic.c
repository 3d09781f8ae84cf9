/* A stand-in for PEAK's library PCAN-Basic, so that python-can's pcan backend runs without an adapter.
 *
 * It has the functions that the backend calls, with their signatures and status codes. Its channels, USB 1 to 8, hang on one bus:
 * what is written to one comes out of all others that were initialised with the same bit rate; one with another bit rate sees a
 * stuff error instead. What goes wrong is set by the stand_in_... functions, which no such library has.
 */

#include <pthread.h>
#include <stdint.h>
#include <string.h>
#include <sys/eventfd.h>
#include <time.h>
#include <unistd.h>

enum {
    OK = 0, OVERRUN = 0x2, BUSOFF = 0x10, QRCVEMPTY = 0x20, QOVERRUN = 0x40, QXMTFULL = 0x80, NODRIVER = 0x200,
    HWINUSE = 0x400, ILLHW = 0x1400, ILLPARAMTYPE = 0x4000, CAUTION = 0x2000000, INITIALIZE = 0x4000000,
    ANY_BUS_ERROR = 0x4001C
};
enum {
    RECEIVE_EVENT = 0x03, API_VERSION = 0x05, BUSOFF_AUTORESET = 0x07, LISTEN_ONLY = 0x08, CHANNEL_CONDITION = 0x0D,
    ALLOW_ERROR_FRAMES = 0x20, ATTACHED_COUNT = 0x2A, ATTACHED = 0x2B
};
enum { STATUS_TEXTS = 12, CHANNELS = 8, QUEUE = 32768, FIRST_HANDLE = 0x51, ERROR_FRAME = 0x40, STUFF_ERROR = 4, USB = 5 };

typedef struct { uint32_t id; uint8_t type, length, data[8]; } Message;
typedef struct { uint32_t millis; uint16_t overflow, micros; } Stamp;
typedef struct {
    uint16_t handle; uint8_t device, controller; uint32_t features; char name[33]; uint32_t id, condition;
} Information;

typedef struct {
    int is_absent, is_occupied, is_open, auto_reset, listen_only, event, full;
    uint16_t bitrate;
    uint32_t status, next_read;
    unsigned first, count;
    Message queue[QUEUE];
} Channel;

static Channel channels[CHANNELS];
static unsigned queue_size = QUEUE;
static int has_no_driver;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

static const struct { uint32_t status; const char *text; } texts[STATUS_TEXTS] = {
    {OK, "No error"}, {0x1, "The controller's transmit buffer is full"}, {OVERRUN, "The controller was read too late"},
    {0x4, "An error counter reached the light limit"}, {0x8, "An error counter reached the heavy limit"},
    {BUSOFF, "The controller is bus-off"}, {QOVERRUN, "The receive queue was read too late"},
    {QXMTFULL, "The transmit queue is full"}, {NODRIVER, "The driver is not loaded"},
    {HWINUSE, "The hardware is in use already"}, {ILLHW, "The hardware handle is invalid"},
    {0x40000, "The controller is error passive"},
};

static Stamp now(void) /* since the computer was started, as the library has it */
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    uint64_t millis = (uint64_t)time.tv_sec * 1000 + (uint64_t)time.tv_nsec / 1000000;
    return (Stamp){(uint32_t)millis, (uint16_t)(millis >> 32), (uint16_t)(time.tv_nsec / 1000 % 1000)};
}

static Channel *channel_of(uint16_t handle)
{
    return handle >= FIRST_HANDLE && handle < FIRST_HANDLE + CHANNELS ? &channels[handle - FIRST_HANDLE] : NULL;
}

static uint32_t check(const Channel *channel)
{
    if (has_no_driver) return NODRIVER;
    if (!channel || channel->is_absent) return ILLHW;
    return channel->is_open ? OK : INITIALIZE;
}

static void put(Channel *channel, const Message *message)
{
    uint64_t one = 1;
    if (channel->count == queue_size) {
        channel->next_read = QOVERRUN;
        return;
    }
    channel->queue[(channel->first + channel->count++) % QUEUE] = *message;
    if (write(channel->event, &one, sizeof one) < 0) channel->next_read = OVERRUN;
}

uint32_t CAN_Initialize(uint16_t handle, uint16_t bitrate, uint8_t type, uint32_t port, uint16_t interrupt)
{
    Channel *channel = channel_of(handle);
    uint32_t result;
    (void)type, (void)port, (void)interrupt;
    pthread_mutex_lock(&lock);
    result = check(channel);
    if (result == INITIALIZE) {
        result = channel->is_occupied ? HWINUSE : OK;
        if (result == OK) {
            channel->is_open = 1;
            channel->bitrate = bitrate;
            channel->status = channel->next_read = channel->first = channel->count = 0;
            channel->event = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
        }
    } else if (result == OK) {
        result = HWINUSE;
    }
    pthread_mutex_unlock(&lock);
    return result;
}

uint32_t CAN_Uninitialize(uint16_t handle)
{
    Channel *channel = channel_of(handle);
    pthread_mutex_lock(&lock);
    if (channel && channel->is_open) {
        close(channel->event);
        channel->is_open = channel->auto_reset = channel->listen_only = channel->full = 0;
    }
    pthread_mutex_unlock(&lock);
    return OK;
}

uint32_t CAN_Reset(uint16_t handle) /* empties the queue, and leaves the controller as it is */
{
    uint32_t result;
    pthread_mutex_lock(&lock);
    result = check(channel_of(handle));
    if (result == OK) channel_of(handle)->count = 0;
    pthread_mutex_unlock(&lock);
    return result;
}

uint32_t CAN_GetStatus(uint16_t handle)
{
    Channel *channel = channel_of(handle);
    uint32_t result;
    pthread_mutex_lock(&lock);
    result = check(channel);
    if (result == OK) {
        result = channel->status;
        if (channel->auto_reset) channel->status &= ~(uint32_t)BUSOFF;
    }
    pthread_mutex_unlock(&lock);
    return result;
}

uint32_t CAN_Read(uint16_t handle, Message *message, Stamp *stamp)
{
    Channel *channel = channel_of(handle);
    uint64_t events;
    uint32_t result;
    pthread_mutex_lock(&lock);
    result = check(channel);
    if (result == OK) {
        if (channel->count) {
            *message = channel->queue[channel->first];
            channel->first = (channel->first + 1) % QUEUE;
            channel->count--;
            *stamp = now();
        } else if (channel->next_read) {
            result = channel->next_read;
            channel->next_read = OK;
        } else {
            result = QRCVEMPTY;
            if (read(channel->event, &events, sizeof events) < 0) events = 0; /* nothing happened since */
        }
    }
    pthread_mutex_unlock(&lock);
    return result;
}

uint32_t CAN_Write(uint16_t handle, const Message *message)
{
    static const Message disturbed = {STUFF_ERROR, ERROR_FRAME, 4, {1, 0, 8, 0}};
    Channel *channel = channel_of(handle);
    uint32_t result;
    pthread_mutex_lock(&lock);
    result = check(channel);
    if (result == OK && channel->status & BUSOFF) result = BUSOFF;
    if (result == OK && channel->full) {
        channel->full--;
        result = QXMTFULL;
    }
    for (Channel *other = channels; result == OK && !channel->listen_only && other < channels + CHANNELS; other++)
        if (other != channel && check(other) == OK && !(other->status & BUSOFF))
            put(other, other->bitrate == channel->bitrate ? message : &disturbed);
    pthread_mutex_unlock(&lock);
    return result;
}

uint32_t CAN_GetValue(uint16_t handle, uint8_t parameter, void *buffer, uint32_t size)
{
    Channel *channel = channel_of(handle);
    Information *information = buffer;
    uint32_t result = OK, count = 0;
    pthread_mutex_lock(&lock);
    if (parameter == API_VERSION) {
        strncpy(buffer, "4.8.0.5", size);
    } else if (parameter == ATTACHED || parameter == ATTACHED_COUNT) {
        for (unsigned number = 0; number < CHANNELS && !has_no_driver; number++) {
            channel = &channels[number];
            if (channel->is_absent) continue;
            if (parameter == ATTACHED && (count + 1) * sizeof *information <= size) {
                memset(&information[count], 0, sizeof *information);
                information[count].handle = (uint16_t)(FIRST_HANDLE + number);
                information[count].device = USB;
                strcpy(information[count].name, "PCAN-USB");
                information[count].condition = channel->is_occupied || channel->is_open ? 2 : 1;
            }
            count++;
        }
        if (parameter == ATTACHED_COUNT) *(uint32_t *)buffer = count;
        if (has_no_driver) result = NODRIVER;
    } else if (parameter == CHANNEL_CONDITION) {
        *(uint32_t *)buffer = !channel || channel->is_absent ? 0 : channel->is_occupied || channel->is_open ? 2 : 1;
    } else if (parameter == RECEIVE_EVENT) {
        result = check(channel);
        if (result == OK) *(int *)buffer = channel->event;
    } else {
        result = ILLPARAMTYPE;
    }
    pthread_mutex_unlock(&lock);
    return result;
}

uint32_t CAN_SetValue(uint16_t handle, uint8_t parameter, const void *buffer, uint32_t size)
{
    Channel *channel = channel_of(handle);
    uint32_t result = OK;
    int value = size >= sizeof(int) ? *(const int *)buffer : 0;
    pthread_mutex_lock(&lock);
    if (!channel) result = ILLHW;
    else if (parameter == BUSOFF_AUTORESET) channel->auto_reset = value;
    else if (parameter == LISTEN_ONLY) channel->listen_only = value; /* also before CAN_Initialize */
    else if (parameter != ALLOW_ERROR_FRAMES && parameter != RECEIVE_EVENT) result = ILLPARAMTYPE;
    pthread_mutex_unlock(&lock);
    return result;
}

uint32_t CAN_GetErrorText(uint32_t status, uint16_t language, char *buffer)
{
    (void)language;
    for (int number = 0; number < STATUS_TEXTS; number++)
        if (texts[number].status == status) {
            strcpy(buffer, texts[number].text);
            return OK;
        }
    return ILLPARAMTYPE;
}

/* ---- for tests ---- */

void stand_in_clear(void)
{
    for (uint16_t number = 0; number < CHANNELS; number++) CAN_Uninitialize((uint16_t)(FIRST_HANDLE + number));
    memset(channels, 0, sizeof channels);
    queue_size = QUEUE;
    has_no_driver = 0;
}

void stand_in_driver(int is_loaded) { has_no_driver = !is_loaded; }

void stand_in_queue(unsigned size) { queue_size = size; }

void stand_in_occupy(uint16_t handle) { channel_of(handle)->is_occupied = 1; }

int stand_in_listens_only(uint16_t handle) { return channel_of(handle)->listen_only; }

uint16_t stand_in_bitrate(uint16_t handle) { return channel_of(handle)->bitrate; }

void stand_in_plug(uint16_t handle, int is_there)
{
    pthread_mutex_lock(&lock);
    channel_of(handle)->is_absent = !is_there;
    pthread_mutex_unlock(&lock);
}

void stand_in_status(uint16_t handle, uint32_t status) /* what CAN_GetStatus says from now on */
{
    pthread_mutex_lock(&lock);
    channel_of(handle)->status = status;
    pthread_mutex_unlock(&lock);
}

void stand_in_read(uint16_t handle, uint32_t status) /* what the next CAN_Read of the empty queue says */
{
    pthread_mutex_lock(&lock);
    channel_of(handle)->next_read = status;
    pthread_mutex_unlock(&lock);
}

void stand_in_full(uint16_t handle, int times) { channel_of(handle)->full = times; }
