// The interface of the views, of which the router shows one at a time.

export interface View {
  /** The browser tab's title. */
  title: string;
  element: HTMLElement;
  /** Stop the view's background work. */
  leave(): void;
}
