/* ESP32-C3 (RISC-V, rv32imc), ESP-IDF 5: a timer wakes a task, and an AD5683R (16 bits) is on the SPI. Your app_main
 * adds the device to its SPI bus (mode 1) and calls run_axis. */
#include "driver/gptimer.h"
#include "driver/spi_master.h"
#include "freertos/FreeRTOS.h"
#include "freertos/task.h"

#include "axis.h"
#include "rdpi_params.h" /* for its DAC bits */

#if RDPI_PARAMS_DAC_BITS != 16
#error "fit with --dac-bits 16"
#endif

#define RATE_HZ 1000
#define MOST_FAILED 10u /* frames in a row: the first that gets through is a step of as many samples. Yours to choose */

extern axis_t axis; /* yours */

bool run_axis(spi_device_handle_t device);
uint32_t frames_failed(void); /* since the start; 0 on a healthy bus */

/* Yours: MOST_FAILED frames in a row have failed, and no more are sent. The DAC still outputs its last code: switch the
 * amplifier off. */
void axis_stopped(void);

static spi_device_handle_t dac;
static gptimer_handle_t timer;
static TaskHandle_t task;
static volatile uint32_t failed;

static bool on_alarm(gptimer_handle_t source, const gptimer_alarm_event_data_t *event, void *context)
{
    (void)source;
    (void)event;
    (void)context;
    BaseType_t woken = pdFALSE;
    vTaskNotifyGiveFromISR(task, &woken);
    return woken == pdTRUE;
}

/* Its 24 bits: command 3, "write to and update the DAC register"; the code; four bits that do not matter. False if the
 * DAC has not got them: it then outputs the code before. */
static bool write_dac(uint32_t code)
{
    spi_transaction_t frame = {
        .flags = SPI_TRANS_USE_TXDATA,
        .length = 24,
        .tx_data = {(uint8_t)(0x30u | code >> 12), (uint8_t)(code >> 4), (uint8_t)(code << 4)},
    };
    return spi_device_polling_transmit(dac, &frame) == ESP_OK;
}

/* A notification is a counter: what it is more than 1 are ticks that the task was too late for. A code that has not got
 * through is sent again, and axis_next waits for it: the library counts on every code that it has returned. */
static void follow(void *context)
{
    (void)context;
    uint32_t code = axis.life.dac_code, lost = 0, in_a_row = 0;
    while (in_a_row < MOST_FAILED) {
        lost += ulTaskNotifyTake(pdTRUE, portMAX_DELAY) - 1u;
        if (write_dac(code)) {
            code = axis_next(&axis, lost);
            lost = in_a_row = 0;
        } else {
            failed++;
            in_a_row++;
            lost++;
        }
    }
    (void)gptimer_stop(timer); /* if it runs on, nobody listens */
    axis_stopped();
    vTaskDelete(NULL);
}

uint32_t frames_failed(void)
{
    return failed;
}

bool run_axis(spi_device_handle_t device)
{
    dac = device;
    if (axis_start(&axis, RATE_HZ) != RDPI_OK) {
        (void)write_dac(axis.life.dac_code); /* the safe one */
        return false;
    }
    const gptimer_config_t clock = {
        .clk_src = GPTIMER_CLK_SRC_DEFAULT, .direction = GPTIMER_COUNT_UP, .resolution_hz = 1000000};
    const gptimer_alarm_config_t period = {.alarm_count = 1000000 / RATE_HZ, .flags = {.auto_reload_on_alarm = 1}};
    const gptimer_event_callbacks_t callbacks = {.on_alarm = on_alarm};
    return gptimer_new_timer(&clock, &timer) == ESP_OK && gptimer_set_alarm_action(timer, &period) == ESP_OK &&
           gptimer_register_event_callbacks(timer, &callbacks, NULL) == ESP_OK &&
           xTaskCreate(follow, "axis", 2048, NULL, configMAX_PRIORITIES - 1, &task) == pdPASS &&
           gptimer_enable(timer) == ESP_OK && gptimer_start(timer) == ESP_OK;
}
