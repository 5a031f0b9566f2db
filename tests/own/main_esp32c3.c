/* Plays ESP-IDF for examples/own/esp32c3.c: timer, task and an AD5683R. */
#include "driver/gptimer.h"
#include "driver/spi_master.h"
#include "freertos/FreeRTOS.h"
#include "freertos/task.h"
#include "triangle.h"

static gptimer_alarm_cb_t on_alarm;
static TaskFunction_t function;
static uint32_t notified;
static uint64_t period_us;
static bool timer_stopped, axis_is_stopped;

bool run_axis(spi_device_handle_t device);
uint32_t frames_failed(void);
void axis_stopped(void);

void axis_stopped(void)
{
    axis_is_stopped = true;
}

esp_err_t gptimer_new_timer(const gptimer_config_t *config, gptimer_handle_t *timer)
{
    *timer = (gptimer_handle_t)&period_us;
    return config->resolution_hz == 1000000u && config->direction == GPTIMER_COUNT_UP ? ESP_OK : 1;
}

esp_err_t gptimer_set_alarm_action(gptimer_handle_t timer, const gptimer_alarm_config_t *config)
{
    period_us = config->alarm_count;
    return timer != NULL && config->flags.auto_reload_on_alarm ? ESP_OK : 1;
}

esp_err_t gptimer_register_event_callbacks(gptimer_handle_t timer, const gptimer_event_callbacks_t *callbacks,
                                           void *context)
{
    (void)context;
    on_alarm = callbacks->on_alarm;
    return timer != NULL ? ESP_OK : 1;
}

esp_err_t gptimer_enable(gptimer_handle_t timer)
{
    return timer != NULL && on_alarm != NULL ? ESP_OK : 1;
}

esp_err_t gptimer_start(gptimer_handle_t timer)
{
    if (timer == NULL || function == NULL || period_us != 1000u) {
        return 1;
    }
    function(NULL); /* for ever */
    return ESP_OK;
}

esp_err_t gptimer_stop(gptimer_handle_t timer)
{
    timer_stopped = timer == (gptimer_handle_t)&period_us;
    return ESP_OK;
}

void vTaskDelete(TaskHandle_t task)
{
    if (task != NULL || !timer_stopped || !axis_is_stopped || frames_failed() != 10u) {
        exit(5);
    }
    finish();
}

BaseType_t xTaskCreate(TaskFunction_t task_function, const char *name, uint32_t stack_depth, void *context,
                       UBaseType_t priority, TaskHandle_t *task)
{
    (void)name;
    (void)stack_depth;
    (void)context;
    (void)priority;
    function = task_function;
    *task = (TaskHandle_t)&notified;
    return pdPASS;
}

void vTaskNotifyGiveFromISR(TaskHandle_t task, BaseType_t *woken)
{
    (void)task;
    notified++;
    *woken = pdTRUE;
}

uint32_t ulTaskNotifyTake(BaseType_t clear, TickType_t wait)
{
    if (!on_alarm((gptimer_handle_t)&period_us, NULL, NULL) || clear != pdTRUE || wait != portMAX_DELAY) {
        exit(4);
    }
    uint32_t ticks = notified;
    notified = 0;
    return ticks;
}

int spi_device_polling_transmit(spi_device_handle_t device, spi_transaction_t *frame)
{
    (void)device;
    if (frame->flags != SPI_TRANS_USE_TXDATA || frame->length != 24u || frame->tx_data[0] >> 4 != 3u) {
        exit(4);
    }
    if (frame_fails()) {
        dac_gets(dac_got[dac_count - 1u], 0u);
        return 0x107; /* ESP_ERR_TIMEOUT */
    }
    dac_gets((frame->tx_data[0] & 0xFu) << 12 | (uint32_t)frame->tx_data[1] << 4 | frame->tx_data[2] >> 4, 0u);
    return ESP_OK;
}

int main(void)
{
    return run_axis(NULL) ? 2 : 1; /* gptimer_start ends the program */
}
